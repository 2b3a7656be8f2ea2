"""``flipperctl train`` as an application of Hydra: the checks before it, and each of its jobs.

In: the words of the command, including Hydra's options. Out: a run in each job's directory.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import env_override
from hydra.types import RunMode
from omegaconf import OmegaConf

from flipperctl.cli.hydra import config_store
from flipperctl.cli.hydra.compose import check_training_effect, compose_train, parse_training
from flipperctl.cli.hydra.config_files import strict_files
from flipperctl.cli.hydra.errors import convert_hydra_errors
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config.robots import expand_files
from flipperctl.errors import InterruptedRunError
from flipperctl.files import failure
from flipperctl.rollout import ray_cluster
from flipperctl.runs import folder as run_folder
from flipperctl.runs import follow_up, preflight
from flipperctl.runs.command_process import CommandProcess
from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.sweep_stop import stop_of
from flipperctl.terminal.notices import print_notices


def train(arguments: list[str], *, check: bool) -> None:
    """Run Hydra with the words after ``flipperctl train``.

    With ``check``, the composed configurations are checked before Hydra creates a directory.

    Raises:
        RequestError: a word is wrong, or the terrain, device or network cannot be used.
        InterruptedRunError: Ctrl-C was pressed; the training so far is saved.
    """
    config_store.register_defaults()
    config_store.register_sweepers()
    several = "--multirun" in arguments
    arguments = expand_files(arguments)
    checked = _check([a for a in arguments if a != "--multirun"], several=several, compose=check)
    errors: list[BaseException] = []
    job = _Job(CommandProcess.current(), checked)

    def task(composed: Any) -> float | None:
        try:
            return job.run(composed)
        except (Exception, KeyboardInterrupt) as error:  # raised again below
            if several:
                raise
            directory = Path(HydraConfig.get().runtime.output_dir)
            stopped = follow_up.interrupted_run(directory)
            # Hydra would add its own lines to an exception that it handles.
            errors.append(stopped if isinstance(error, KeyboardInterrupt) else error)
            return None

    configured = hydra.main(config_store.CONFIGS, "train", version_base="1.3")
    previous_argv, sys.argv = sys.argv, ["flipperctl train", *arguments]
    try:
        # Hydra passes exceptions on instead of printing them.
        with convert_hydra_errors(), strict_files(), env_override({"HYDRA_FULL_ERROR": "1"}):
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
            ray_cluster.shut_down()  # Hydra's launcher leaves it running


def _check(words: list[str], *, several: bool, compose: bool) -> bool:
    """Refuse a wrong request; return whether the composed configurations were checked."""
    plain = not any(word.startswith("-") for word in words)
    # With options of Hydra, other words may be values of these.
    typed = words if plain else [w for w in words if "=" in w and not w.startswith("-")]
    overrides = Overrides.parse(typed)
    overrides.check_training(several=several)
    # Hydra's options may add other configuration files; then each job checks its own.
    if not (compose and plain):
        return False
    own = overrides.where(lambda key: not key.startswith("hydra"))
    # pymunk swallows a KeyboardInterrupt that is raised while it frees a body.
    with interrupts("stopping …") as stop:
        for probe in (own, *own.interval_probes()):
            for config in compose_train(probe):
                if not stop():
                    preflight.check(config)
    if stop():
        raise KeyboardInterrupt
    return True


@dataclass(frozen=True)
class _Job:
    """A job of Hydra; a launcher may run it in another process."""

    process: CommandProcess
    checked: bool
    """Whether the command has checked the configuration and printed its notices."""

    def run(self, composed: Any) -> float | None:
        """Train with the composed configuration; return the objective of a search."""
        from flipperctl.runs.search import objective
        from flipperctl.runs.training import start, start_or_continue
        from flipperctl.terminal.training import print_best, reports

        settings = HydraConfig.get()
        self.process.restore(folder=not settings.job.chdir)
        config = parse_training(composed)
        preflight.check_device(config)
        if not self.checked:
            check_training_effect(config, Overrides.parse(list(settings.overrides.task)))
            preflight.check(config)
            print_notices(config)
        directory = Path(settings.runtime.output_dir)
        keep = _keeper(composed, directory)
        if settings.mode is RunMode.MULTIRUN:
            stop = stop_of(Path(settings.runtime.cwd, settings.sweep.dir), self.process.holder)
            if stop():
                raise InterruptedRunError(f"{directory.name} was not started")
            run = start_or_continue(config, directory, reports(), keep_more=keep, stop=stop)
        else:
            run = start(config, directory, reports(), keep_more=keep)
        print_best(run)
        train = config.train
        return objective(run.summary["best"], train.validation_episodes, train.best_by)


def _keeper(composed: Any, directory: Path) -> Callable[[], None]:
    """Return a function that writes Hydra's own files, to call once the directory is locked."""

    def keep() -> None:
        settings = HydraConfig.get()
        if settings.output_subdir is None:  # else Hydra has written them
            documents = {
                "config": composed,
                "hydra": {"hydra": OmegaConf.to_container(settings)},
                "overrides": settings.overrides.task,
            }
            run_folder.write_hydra(directory, documents)

    return keep
