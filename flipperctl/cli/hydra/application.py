"""``flipperctl train`` as an application of Hydra: the checks before it, and each of its jobs.

In: the words of the command, including Hydra's options. Out: a run in each job's directory.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import env_override
from hydra.types import RunMode
from omegaconf import OmegaConf, read_write

from flipperctl.checkpoint import results
from flipperctl.cli.hydra.sweeps import named_by_time, register_sweepers
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError, InterruptedRunError
from flipperctl.process import session
from flipperctl.process.session import interrupts
from flipperctl.requests.compose import (
    CONFIGS,
    check_training_effect,
    compose_train,
    parse_training,
    preset_folders,
    register_defaults,
)
from flipperctl.requests.errors import convert_hydra_errors
from flipperctl.requests.request import SEARCH_PATH, Requests
from flipperctl.requests.text import from_words
from flipperctl.rollout.cluster import shut_down
from flipperctl.rollout.statement import Statement
from flipperctl.terminal.streams import print_note, print_notices
from flipperctl.text.files import failure
from flipperctl.training import folder as run_folder
from flipperctl.training import run as training_run
from flipperctl.training.sweep import stop_of


def train(
    overrides: Sequence[str],
    *,
    multirun: bool = False,
    config_dir: Path | None = None,
    film: Path | None = None,
) -> None:
    """Run Hydra with the overrides and its own options.

    The composed configurations are checked before Hydra creates a directory. ``film``: file for a
    film of a single run's policy at each of its validations.

    Raises:
        RequestError: a word is wrong, or the terrain, device or network cannot be used.
        InterruptedRunError: Ctrl-C was pressed; the training so far is saved.
    """
    register_defaults()
    register_sweepers()
    # Hydra gets words that are known to be good; files of the user's are checked by each job.
    requests = from_words([*overrides, *([] if film is None else ["train.keep_policies=true"])])
    several = _several(requests, multirun=multirun)
    checked = config_dir is None
    requests.check_training(several=several or not checked)
    if requests.choice("perception") is None and "perception=lidar" in requests.words:
        print_note("perception=lidar, as devices of a robot are named")
    configs = _check(requests) if checked else []
    folder = ["--config-dir", str(config_dir)] if config_dir else []
    words = [*(["--multirun"] if multirun else []), *folder, *requests.words]

    # The error of a single run is kept from Hydra.
    errors: list[BaseException] = []
    job = _Job(
        _CommandProcess.current(), checked, None if several else next(iter(configs), None), film
    )

    def task(composed: Any) -> float | None:
        try:
            return job.run(composed)
        except (Exception, KeyboardInterrupt) as error:  # raised again below
            if HydraConfig.get().mode is RunMode.MULTIRUN:
                raise
            directory = Path(HydraConfig.get().runtime.output_dir)
            _remove_empty(directory)
            stopped = session.interrupted_run(directory)
            # Hydra would add its own lines to an exception that it handles.
            errors.append(stopped if isinstance(error, KeyboardInterrupt) else error)
            return None

    # Hydra reads its words from sys.argv alone.
    application = hydra.main(CONFIGS, "train", version_base="1.3")(task)
    previous_argv, sys.argv = sys.argv, ["flipperctl train", *words]
    try:
        # Hydra passes exceptions on instead of printing them. The processes of a launcher must not
        # import from the working directory, where a user's random.py may lie.
        environment = {"HYDRA_FULL_ERROR": "1", "PYTHONSAFEPATH": "1"}
        with convert_hydra_errors(), preset_folders(), env_override(environment):
            application()
        if errors:
            raise errors[0]
    except KeyboardInterrupt as error:  # while worker processes train
        raise InterruptedRunError(
            f"interrupted; resume a saved run with: {session.command('train', '--resume', 'RUN')}"
        ) from error
    except OSError as error:
        if error.filename is None:
            raise
        raise failure(Path(error.filename), error) from error
    finally:
        sys.argv = previous_argv
        if several:
            shut_down()  # Hydra's launcher leaves it running


def _remove_empty(directory: Path) -> None:
    """Remove what Hydra made for a run that has written nothing, within the working directory."""
    here = Path.cwd()
    for folder in (directory, *directory.parents):
        if here in folder.parents:
            with contextlib.suppress(OSError):  # it holds files, or is gone already
                folder.rmdir()


def _several(requests: Requests, *, multirun: bool) -> bool:
    """Return whether the command makes several runs: by its option, or by Hydra's setting."""
    mode = requests.choice("hydra.mode")
    if multirun and mode == RunMode.RUN.name:
        raise ConfigError(f"hydra.mode={mode}: no meaning beside --multirun; leave it out")
    return multirun or mode == RunMode.MULTIRUN.name


def _check(requests: Requests) -> list[TrainConfig]:
    """Refuse a wrong request before Hydra creates a directory; return the configurations."""
    configs = []
    settings = requests.where(lambda key: not key.startswith("hydra") or key == SEARCH_PATH)
    # pymunk swallows a KeyboardInterrupt that is raised while it frees a body.
    with interrupts("stopping …") as stop:
        for probe in (settings, *settings.interval_probes()):
            for config in compose_train(probe):
                if not stop():
                    training_run.check(config)
                configs.append(config)
    if stop():
        raise KeyboardInterrupt
    return configs


@dataclass(frozen=True)
class _CommandProcess:
    """Plugins, working directory and identity of a command's process; picklable."""

    code: Statement
    """What it computes with, its plugins included."""
    typed: list[str]
    """Plugins that ``--plugins`` named."""
    folder: Path
    """Working directory, which is another one in a worker of a running cluster."""
    holder: tuple[str, int]
    """The process (``results.holder``), whose death a job notices."""

    @classmethod
    def current(cls) -> _CommandProcess:
        """Return this process."""
        return cls(Statement.of_code(), session.plugin_paths(), Path.cwd(), results.holder())

    def restore(self) -> None:
        """Load the plugins in a job, and enter the working directory if it exists.

        A job of Hydra leaves it with ``hydra.job.chdir=true``, but the user's paths start there.
        On another machine it must have the same code and plugins.
        """
        if self.folder.is_dir():
            os.chdir(self.folder)
        self.code.enter()
        session.remember_plugins(self.typed)


@dataclass(frozen=True)
class _Job:
    """A job of Hydra; a launcher may run it in another process."""

    process: _CommandProcess
    checked: bool
    """Whether the command has checked the configuration and printed its notices."""
    config: TrainConfig | None
    """The checked configuration of a single run, so that nothing is merged twice."""
    film: Path | None
    """File for a film of the policy at each validation, if one is wanted."""

    def run(self, composed: Any) -> float | None:
        """Train with the composed configuration; return the objective of a search."""
        from flipperctl.requests.filming import check_training_film, film_training
        from flipperctl.terminal.training import print_best, reports
        from flipperctl.training.search import objective

        settings = HydraConfig.get()
        self.process.restore()
        if settings.job.chdir:
            print_note(
                f"note: hydra.job.chdir=true: the run stays in {Path.cwd()}, where all paths start"
            )
        config = self.config or parse_training(composed)
        training_run.check_device(config)
        if not self.checked:
            check_training_effect(config, from_words(settings.overrides.task))
            training_run.check(config)
            print_notices(config)
        directory = Path(settings.runtime.output_dir)
        keep = partial(_keep, composed)
        if settings.mode is RunMode.MULTIRUN:
            # A job of a sweep stops with the command, and goes on where it stopped.
            stop = stop_of(Path(settings.runtime.cwd, settings.sweep.dir), self.process.holder)
            if stop():
                raise InterruptedRunError(f"{directory.name} was not started")
            run = training_run.start_or_continue(
                config, directory, reports(), keep_more=partial(keep, directory), stop=stop
            )
        else:
            hydra: Any = HydraConfig.instance().cfg
            numbered = named_by_time(hydra, "run")
            if self.film is not None:
                check_training_film(self.film, config)
            run = training_run.start(
                config, directory, reports(), keep_more=keep, numbered=numbered
            )
        print_best(run)
        if self.film is not None:
            film_training(run.directory, config, self.film, print_note)
        train = config.train
        return objective(run.summary["best"], train.validation_episodes, train.best_by)


def _keep(composed: Any, directory: Path) -> None:
    """Write Hydra's own files, once the directory is locked."""
    settings = HydraConfig.get()
    runtime: Any = settings.runtime
    with read_write(runtime):  # another one was taken
        runtime.output_dir = str(directory)
    if settings.output_subdir is None:  # else Hydra has written them
        documents = {
            "config": composed,
            "hydra": {"hydra": OmegaConf.to_container(settings)},
            "overrides": settings.overrides.task,
        }
        run_folder.write_hydra(directory, documents)
