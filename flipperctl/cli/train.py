"""``flipperctl train``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from flipperctl.cli.command import TrainingCommand
from flipperctl.cli.options import Overrides, PluginPaths
from flipperctl.terminal import follow_up

HYDRA_OPTIONS = [
    *("-m", "--multirun", "-c", "--cfg", "-p", "--package", "--resolve", "-i", "--info"),
    *("-cd", "--config-dir", "-cn", "--config-name", "-cp", "--config-path", "--hydra-help"),
]
_RESUMABLE = ("train.", "device", "logger")

HELP = """Train a policy. Progress goes to stderr, everything else to the run directory.

OVERRIDES are Hydra's: key=value. [bold]flipperctl inspect config[/] shows every key.

[bold]Examples[/]

  flipperctl train terrain=stair

  flipperctl train terrain=step seed=3 train.decisions=40000 rewards.pitch.lambda_2=8

  flipperctl train -m terrain=step,stair seed=1,2

  flipperctl train --resume runs/stair/2026-01-31_12-00-00
"""


class TrainCommand(TrainingCommand):
    """The subcommand, which hands Hydra's options on."""

    foreign_options = HYDRA_OPTIONS


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    settings = {"ignore_unknown_options": True}  # Hydra's own options arrive as overrides
    app.command("train", help=HELP, cls=TrainCommand, context_settings=settings)(train)


def train(
    overrides: Overrides = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Resume a run where it stopped."),
    ] = None,
    multirun: Annotated[
        bool, typer.Option("--multirun", "-m", help="One run for each combination of a,b lists.")
    ] = False,
    cfg: Annotated[
        str | None,
        typer.Option(metavar="job|hydra|all", help="Print the composed configuration and stop."),
    ] = None,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import plugins as loader

    arguments = list(overrides or [])
    loader.load(plugins or ())
    if resume is not None:
        _resume(resume, arguments)
        return
    if cfg is not None:
        arguments += ["--cfg", cfg]
    if multirun:
        arguments.append("--multirun")
    _hydra(arguments, check=cfg is None)


def _hydra(arguments: list[str], *, check: bool) -> None:
    import hydra
    from hydra.core.hydra_config import HydraConfig
    from hydra.core.utils import env_override

    from flipperctl import plugins as loader
    from flipperctl.cli import preflight
    from flipperctl.cli.hydra import config_store
    from flipperctl.cli.hydra.errors import convert_hydra_errors
    from flipperctl.errors import InterruptedRunError
    from flipperctl.files import failure
    from flipperctl.runs.lock import holder

    config_store.register_defaults()
    config_store.register_sweepers()
    several = "--multirun" in arguments
    overrides = [a for a in arguments if a != "--multirun"]
    if not several:
        preflight.check_single(overrides)
    preflight.check(overrides, compose=check)
    checked = check and preflight.plain(overrides)
    errors: list[BaseException] = []
    # A worker on a running cluster has another environment and another working directory.
    paths, typed, here = loader.configured_paths(), follow_up.plugin_paths(), Path.cwd()
    sweeper = holder()

    def task(composed: Any) -> float | None:
        try:
            if not HydraConfig.get().job.chdir and here.is_dir():
                os.chdir(here)
            return _task(composed, paths, typed, sweeper, checked=checked)
        except (Exception, KeyboardInterrupt) as error:  # raised again below
            if several:
                raise
            directory = Path(HydraConfig.get().runtime.output_dir)
            stopped = InterruptedRunError(
                f"interrupted. Resume with: {follow_up.command('train', '--resume', directory)}"
            )
            # Hydra would add lines of its own to what passes through it.
            errors.append(stopped if isinstance(error, KeyboardInterrupt) else error)
            return None

    configured = hydra.main(config_store.CONFIGS, "train", version_base="1.3")
    previous_argv, sys.argv = sys.argv, ["flipperctl train", *arguments]
    try:
        # Hydra passes exceptions on, instead of printing them itself.
        with convert_hydra_errors(), env_override({"HYDRA_FULL_ERROR": "1"}):
            configured(task)()
        if errors:
            raise errors[0]
    except KeyboardInterrupt as error:  # while worker processes train
        raise InterruptedRunError(
            f"interrupted; resume a saved run with: {follow_up.command('train', '--resume', 'RUN')}"
        ) from error
    except OSError as error:
        if error.filename is None:
            raise
        raise failure(Path(error.filename), error) from error
    finally:
        sys.argv = previous_argv
        if several:
            _shut_ray_down()


def _shut_ray_down() -> None:
    """Shut Ray down, which Hydra's launcher leaves running until this process ends."""
    ray = sys.modules.get("ray")
    if ray is not None and ray.is_initialized():
        ray.shutdown()


def _task(
    composed: Any, paths: list[str], typed: list[str], sweeper: dict[str, Any], *, checked: bool
) -> float | None:
    """Run one job of Hydra; a launcher's worker process loads the plugins itself.

    ``paths`` are those of all plugins, ``typed`` those of ``--plugins``. ``sweeper`` is the process
    of the command (``lock.holder``), which may be another one. ``checked``: the command has
    composed the configuration before, and printed its notices.
    """
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    from flipperctl import plugins as loader
    from flipperctl.cli import preflight
    from flipperctl.cli.hydra.compose import parse_training
    from flipperctl.cli.training import start, start_or_go_on
    from flipperctl.errors import InterruptedRunError
    from flipperctl.runs.search import objective
    from flipperctl.runs.sweep_stop import stop_of
    from flipperctl.terminal.notices import print_notices

    loader.load(paths)
    follow_up.remember_plugins(typed)
    config = parse_training(composed)
    preflight.check_device(config)
    if not checked:
        print_notices(config)
    hydra = HydraConfig.get()
    directory = Path(hydra.runtime.output_dir)

    def keep() -> None:
        _keep_hydra_files(composed, directory)

    if hydra.mode is RunMode.MULTIRUN:
        stop = stop_of(Path(hydra.runtime.cwd, hydra.sweep.dir), sweeper)
        if stop():
            raise InterruptedRunError(f"{directory.name} was not begun")
        summary = start_or_go_on(config, directory, keep, stop)
    else:
        summary = start(config, directory, keep)
    return objective(summary["best"], config.train.validation_episodes)


def _keep_hydra_files(composed: Any, directory: Path) -> None:
    """Write Hydra's own files, once the directory is known to be new and ours."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    from flipperctl.files import make_folder, write_bytes
    from flipperctl.runs import folder as run_folder

    hydra = HydraConfig.get()
    if hydra.output_subdir is not None:
        return  # the user asked for them, and Hydra wrote them
    folder = make_folder(directory / run_folder.HYDRA)
    documents = {
        "config": composed,
        "hydra": OmegaConf.create({"hydra": OmegaConf.to_container(hydra)}),
        "overrides": hydra.overrides.task,
    }
    for name, document in documents.items():
        write_bytes(folder / f"{name}.yaml", OmegaConf.to_yaml(document).encode())


def _resume(run: Path, overrides: list[str]) -> None:
    from flipperctl.cli import preflight
    from flipperctl.cli.hydra.errors import convert_hydra_errors
    from flipperctl.cli.hydra.overrides import override_values
    from flipperctl.cli.training import resume_run
    from flipperctl.errors import ConfigError, InterruptedRunError

    for override in overrides:
        if "=" not in override or not override.startswith(_RESUMABLE):
            raise ConfigError(
                f"{override!r}: a resumed run keeps its configuration; "
                "only train.<field>=…, device=… and logger=… can be given with --resume"
            )
    with convert_hydra_errors():
        changes = override_values(overrides)
    try:
        resume_run(run, changes, preflight.check_device)
    except KeyboardInterrupt as error:  # before or after the episodes, which end by themselves
        raise InterruptedRunError(
            f"interrupted. Resume with: {follow_up.command('train', '--resume', run)}"
        ) from error
