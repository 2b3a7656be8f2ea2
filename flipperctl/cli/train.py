"""``flipperctl train``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from flipperctl.cli.options import Overrides, PluginPaths, no_options

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig

HYDRA_OPTIONS = [
    *("-m", "--multirun", "-c", "--cfg", "-p", "--package", "--resolve", "-i", "--info"),
    *("-cd", "--config-dir", "-cn", "--config-name", "-cp", "--config-path", "--hydra-help"),
]
_RESUMABLE = ("train.", "device")

HELP = """Train a policy; progress on stderr, everything else in the run directory.

OVERRIDES are Hydra's: key=value. [bold]flipperctl inspect config[/] shows every key.

[bold]Examples[/]

  flipperctl train terrain=stair

  flipperctl train terrain=step seed=3 train.decisions=40000 rewards.pitch.lambda_2=8

  flipperctl train -m terrain=step,stair seed=1,2

  flipperctl train --resume runs/stair/2026-01-31_12-00-00
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    settings = {"ignore_unknown_options": True}  # Hydra's own options arrive as overrides
    app.command("train", help=HELP, context_settings=settings)(train)


def train(
    overrides: Overrides = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Go on with a run where it stopped."),
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
    no_options(arguments, [*HYDRA_OPTIONS, "--resume", "--plugins"])
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

    from flipperctl import plugins as loader
    from flipperctl.cli import compose, sweeper
    from flipperctl.errors import FlipperctlError, InterruptedRunError
    from flipperctl.run.files import failure

    compose.offer_defaults()
    sweeper.offer()
    several = "--multirun" in arguments
    overrides = [a for a in arguments if a != "--multirun"]
    compose.check_mappings([o for o in overrides if "=" in o and not o.startswith("-")])
    # Hydra's rarer options may bring other configuration files; then the job itself checks.
    if check and not any(a.startswith("-") for a in overrides):
        own = [o for o in overrides if not o.lstrip("+~").startswith("hydra")]
        for probe in ([], *compose.interval_probes(own)):
            for config in compose.compose_train([*own, *probe]):  # before Hydra makes a directory
                _check_device(config)
                _check_terrain(config)
                _check_network(config)
    errors: list[FlipperctlError] = []
    paths = loader.given()  # a worker on a running cluster has another environment

    def task(composed: Any) -> float | None:
        try:
            return _task(composed, paths)
        except FlipperctlError as error:
            if several:
                raise
            errors.append(error)  # Hydra would add lines of its own
            return None

    application = hydra.main(version_base="1.3", config_path=compose.CONFIGS, config_name="train")(
        task
    )
    given, sys.argv = sys.argv, ["flipperctl train", *arguments]
    try:
        with compose.translated(), _full_errors():
            application()
    except KeyboardInterrupt as error:  # while worker processes train
        raise InterruptedRunError(
            "interrupted; a run that had saved goes on with: flipperctl train --resume RUN"
        ) from error
    except OSError as error:
        if error.filename is None:
            raise
        raise failure(Path(error.filename), error) from error
    finally:
        sys.argv = given
        if several:
            _shut_ray_down()
    if errors:
        raise errors[0]


def _shut_ray_down() -> None:
    """Hydra's launcher leaves Ray running for as long as this process lives."""
    ray = sys.modules.get("ray")
    if ray is not None and ray.is_initialized():
        ray.shutdown()


def _full_errors() -> Any:
    """Let Hydra pass exceptions on instead of printing them itself."""
    import os
    from unittest.mock import patch

    return patch.dict(os.environ, HYDRA_FULL_ERROR="1")


def _task(composed: Any, paths: list[str]) -> float | None:
    """One job of Hydra's; in a launcher's worker process the plugins are loaded anew."""
    from hydra.core.hydra_config import HydraConfig

    from flipperctl import plugins as loader
    from flipperctl.cli.compose import validated
    from flipperctl.cli.search import objective
    from flipperctl.cli.training import start

    loader.load(paths)
    config = validated(composed)
    _check_device(config)
    best = start(config, Path(HydraConfig.get().runtime.output_dir))["best"]
    return objective(best, config.train.validation_episodes)


def _check_device(config: TrainConfig) -> None:
    import torch

    from flipperctl.errors import ConfigError

    try:
        torch.empty(0, device=config.device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"device: {config.device!r} cannot be used: {reason}") from error


def _check_terrain(config: TrainConfig) -> None:
    from flipperctl.env.flipper_env import FlipperEnv

    FlipperEnv(config=config.environment()).reset(seed=0)


def _check_network(config: TrainConfig) -> None:
    from flipperctl.agent.demand import check_demand
    from flipperctl.api import ACTIONS

    check_demand(
        config.network, config.perception, len(ACTIONS), config.agent, config.train.decisions
    )


def _resume(run: Path, overrides: list[str]) -> None:
    from omegaconf import OmegaConf

    from flipperctl.cli.compose import translated
    from flipperctl.cli.training import go_on
    from flipperctl.config import TrainConfig, merged, parse
    from flipperctl.errors import ConfigError
    from flipperctl.run import checkpoint

    for override in overrides:
        if "=" not in override or not override.startswith(_RESUMABLE):
            raise ConfigError(
                f"{override!r}: a resumed run keeps its configuration; "
                "only train.<field>=… and device=… can be given with --resume"
            )
    saved = checkpoint.read(checkpoint.find(run, checkpoint.LAST))
    with translated():
        changes = cast("dict[str, Any]", OmegaConf.to_container(OmegaConf.from_dotlist(overrides)))
    config = parse(TrainConfig, merged(saved.config(), changes))
    _check_device(config)
    go_on(config, saved)
