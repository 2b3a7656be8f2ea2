"""Sweeps over lists, run by Hydra's basic sweeper, with folders named after the swept values.

In: overrides, of which some are lists. Out: a run directory for each combination, named after it,
and a table that compares them. Any of Hydra's launchers can train them.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from flipperctl.cli.hydra import ray_launcher
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.hydra.words import literal_override
from flipperctl.errors import InterruptedRunError
from flipperctl.files import make_folder
from flipperctl.runs import follow_up
from flipperctl.runs.comparison import SweepRun, sweep_run, unreturned_run, write_comparison
from flipperctl.runs.lock import hold
from flipperctl.runs.optuna_search import JobResult
from flipperctl.runs.sweep_folder import folder_name
from flipperctl.runs.sweep_stop import stopping
from flipperctl.terminal.sweep import print_comparison

UNNAMED = "${hydra.job.num}_${terrain.name}_seed${seed}"
"""``hydra.sweep.subdir`` of train.yaml, which is replaced by the names of the swept values."""


def uses_default_naming(config: DictConfig) -> bool:
    """Return whether ``hydra.sweep.subdir`` is still that of train.yaml."""
    sweep: Any = OmegaConf.to_container(config.hydra.sweep, resolve=False)
    return bool(sweep["subdir"] == UNNAMED)


def job_result(job: JobReturn) -> JobResult:
    """Return the value that a job returned, or the error that ended it.

    ``return_value`` writes a line to stderr before it raises the error. That line is hidden,
    since the command shows the error itself.
    """
    composed: Any = job.hydra_cfg
    folder = Path(composed.hydra.runtime.output_dir)
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return JobResult(folder, job.return_value, None)
        except Exception as error:  # noqa: BLE001 (a job may fail in any way)
            return JobResult(folder, None, error)


class SweepLauncher:
    """Hydra's launcher with named folders; it keeps the results of the jobs."""

    def __init__(self, launcher: Launcher, folder: Path, *, named: bool) -> None:
        """``folder``: that of the sweep; ``named``: whether runs are named after swept values."""
        self._launcher, self._named = launcher, named
        self._typed_folder, self._folder = folder, folder.absolute()
        self.stop: Callable[[], bool] = lambda: False
        """Called before each launch; once it returns True, no further job begins."""
        self.jobs = 0
        """Number of jobs that were asked for."""
        self.swept: list[str] = []
        """Keys that the sweep varies."""
        self.runs: list[SweepRun] = []

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Train each job; return the results of Hydra's launcher, fewer after an interrupt."""
        from hydra._internal.core_plugins.basic_launcher import BasicLauncher

        # Hydra's basic launcher runs the jobs in sequence and would continue after Ctrl-C.
        size = 1 if isinstance(self._launcher, BasicLauncher) else len(job_overrides)
        returns: list[JobReturn] = []
        self.jobs += len(job_overrides)
        for start in range(0, len(job_overrides), size):
            number = initial_job_idx + start
            stopped = self.runs and isinstance(self.runs[-1].error, InterruptedRunError)
            if stopped or self.stop():
                self._leave_out(job_overrides[start:], number)
                break
            returns += self._launch(job_overrides[start : start + size], number)
        return returns

    def _leave_out(self, jobs: Sequence[Sequence[str]], first: int) -> None:
        """Add the runs of jobs that are not launched, if their folders have known names."""
        swept = [self._swept_values(job) for job in jobs]
        error = InterruptedRunError("interrupted")
        self.runs += [
            unreturned_run(first + i, values, self._folder / folder_name(first + i, values), error)
            for i, values in enumerate(swept)
            if self._named and self.swept
        ]

    def _launch(self, jobs: Sequence[Sequence[str]], first: int) -> Sequence[JobReturn]:
        swept = [self._swept_values(job) for job in jobs]
        # A worker of a running cluster has another working directory.
        jobs = [[*job, literal_override("hydra.sweep.dir", str(self._folder))] for job in jobs]
        names: list[str] = []
        if self._named and self.swept:
            names = [folder_name(first + i, values) for i, values in enumerate(swept)]
            jobs = [
                [*job, f"hydra.sweep.subdir='{name}'"]
                for job, name in zip(jobs, names, strict=True)
            ]
        try:
            ray_launcher.connect(self._launcher)
            returns = self._launcher.launch(jobs, initial_job_idx=first)
        except BaseException as error:  # a second Ctrl-C, or a worker process that was killed
            stopped = self.stop() or isinstance(error, KeyboardInterrupt)
            cause = InterruptedRunError("interrupted") if stopped else error
            self.runs += [
                unreturned_run(first + i, swept[i], self._folder / name, cause)
                for i, name in enumerate(names)
            ]
            if stopped and isinstance(error, Exception):
                raise cause from error
            raise
        results = [job_result(job) for job in returns]
        self.runs += [
            sweep_run(first + i, swept[i], found.folder, found.error)
            for i, found in enumerate(results)
        ]
        return returns

    def train(self, jobs: Sequence[Sequence[str]], first: int) -> list[JobResult]:
        """Train each job of a search; ``first`` is the number of the first one."""
        return [job_result(job) for job in self.launch(jobs, initial_job_idx=first)]

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Hold the sweep's folder; Ctrl-C sets ``stop``; compare the runs at the end.

        Raises:
            RunHeldError: another process works in the folder.
        """
        with hold(make_folder(self._typed_folder), "sweep"):
            try:
                with stopping(self._typed_folder) as self.stop:
                    yield
            finally:
                compared = write_comparison(self._typed_folder, self.runs)
                print_comparison(self._typed_folder, compared)

    def _swept_values(self, job: Sequence[str]) -> dict[str, str]:
        values = dict(override.partition("=")[::2] for override in job)
        return {key.lstrip("+~"): values[key] for key in self.swept if key in values}


class ListSweep:
    """Hydra's basic sweeper, with named folders and a table at the end."""

    def __init__(
        self,
        settings: Mapping[str, Any],
        *,
        hydra_context: HydraContext,
        task_function: TaskFunction,
        config: DictConfig,
    ) -> None:
        """``settings`` are those of Hydra's basic sweeper."""
        # Not at the top of this file: Hydra reloads its own plugins when it discovers them.
        from hydra._internal.core_plugins.basic_sweeper import BasicSweeper

        self._params = settings["params"] or {}
        self._sweeper = cast("Any", BasicSweeper(**settings))
        self._sweeper.setup(hydra_context=hydra_context, task_function=task_function, config=config)
        self._folder = Path(str(config.hydra.sweep.dir))
        self._jobs = SweepLauncher(
            self._sweeper.launcher, self._folder, named=uses_default_naming(config)
        )
        self._sweeper.launcher = _RaisingLauncher(self._jobs)

    def run(self, arguments: list[str]) -> None:
        """Train every combination, from where an earlier start in the same folder left it.

        Raises:
            FlipperctlError: the first of the jobs' errors, raised after all jobs have run.
            InterruptedRunError: the sweep was stopped; the text has the command to go on with.
            RunHeldError: another process works in the sweep's folder.
        """
        overrides = [*(f"{key}={value}" for key, value in self._params.items()), *arguments]
        self._jobs.swept = Overrides.parse(overrides, check=False).swept
        with self._jobs.held():
            try:
                self._sweeper.sweep(arguments)
            except (InterruptedRunError, KeyboardInterrupt) as error:
                done = sum(run.state == "finished" for run in self._jobs.runs)
                raise InterruptedRunError(
                    f"interrupted; {done} of {self._jobs.jobs} runs are finished. "
                    f"Go on with: {command_to_go_on(self._folder)}"
                ) from error


def command_to_go_on(folder: Path) -> str:
    """Return the command that goes on with the sweep in ``folder``, which this process runs."""
    words = [word for word in sys.argv[1:] if word != "--multirun"]
    if not any(word.startswith("hydra.sweep.dir=") for word in words):
        short = os.path.relpath(folder) if folder.is_relative_to(Path.cwd()) else str(folder)
        plain = re.fullmatch(r"[\w./-]+", short) is not None
        words.append(f"hydra.sweep.dir={short}" if plain else f"hydra.sweep.dir='{short}'")
    return follow_up.command("train", "-m", *words)


class _RaisingLauncher:
    """A launcher that raises the first job's error before Hydra's sweeper rewords it."""

    def __init__(self, jobs: SweepLauncher) -> None:
        self._jobs = jobs

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        returns = self._jobs.launch(job_overrides, initial_job_idx=initial_job_idx)
        errors = [run.error for run in self._jobs.runs if run.error is not None]
        if self._jobs.stop() or any(isinstance(e, InterruptedRunError) for e in errors):
            raise InterruptedRunError("interrupted")
        if errors:
            raise errors[0]
        return returns
