"""Launch the jobs of a sweep or a search, stop them together and compare their runs.

In: jobs, each a list of overrides, and a launcher. Out: a run directory for each job,
``sweep.csv`` in the sweep's folder, and the result of each job.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from flipperctl.errors import InterruptedRunError, RunHeldError
from flipperctl.files import make_folder
from flipperctl.results import hold, names
from flipperctl.runs.comparison import SweepRun, sweep_run, unreturned_run, write_comparison
from flipperctl.runs.sweep_folder import folder_name
from flipperctl.runs.sweep_stop import stopping

Job = Sequence[str]
"""The overrides of one training."""


@dataclass(frozen=True)
class JobResult:
    """The result of one job."""

    folder: Path
    """The run's directory."""
    value: float | None
    """The objective of a search; None without a validation, or after an error."""
    error: Exception | None


Launch = Callable[[Sequence[Job], Sequence[str], int], Sequence[JobResult]]
"""Trains jobs in folders of the given names, or of the launcher's own if there are none; the last
argument is the number of the first job."""


_AT_ONCE = 1.0
"""Time within which a run returns that was finished before [s]; it tells nothing of the others."""


class Sweep:
    """The jobs of a sweep and their results."""

    def __init__(
        self,
        folder: Path,
        launch: Launch,
        show: Callable[[Path, Sequence[SweepRun]], None],
        *,
        named: bool,
        serial: bool,
        numbered: bool = False,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """``folder`` is that of the sweep; ``show`` is called with it and the runs at the end.

        ``named``: whether runs are named after the swept values. ``serial``: whether jobs are
        launched one by one, so that none begins after Ctrl-C; ``tell`` is then called with a line
        before each of several. ``numbered``: whether another folder beside ``folder`` is taken if
        another process works in it.
        """
        self._numbered = numbered
        self.folder = folder
        self._launcher, self._show, self._named, self._serial = launch, show, named, serial
        self._tell = tell
        self.stop: Callable[[], bool] = lambda: False
        """Called before each launch; once it returns True, no further job begins."""
        self.jobs = 0
        """Number of requested jobs."""
        self.swept: list[str] = []
        """Keys that the sweep varies."""
        self.runs: list[SweepRun] = []

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Lock the sweep's folder, stop jobs after Ctrl-C, and compare the runs at the end.

        Raises:
            RunHeldError: another process works in the folder.
        """
        with contextlib.ExitStack() as stack:
            for place in names(self.folder, numbered=self._numbered):
                try:
                    stack.enter_context(hold(make_folder(place), "sweep", "in use"))
                    self.folder = place
                    break
                except RunHeldError:
                    if not self._numbered:
                        raise
            try:
                with stopping(self.folder) as self.stop:
                    yield
            finally:
                self._show(self.folder, write_comparison(self.folder, self.runs))

    def launch(self, jobs: Sequence[Job], first: int) -> list[JobResult]:
        """Train each job and return the results, fewer after an interrupt.

        ``first`` is the number of the first job.
        """
        size = 1 if self._serial else len(jobs)
        results: list[JobResult] = []
        times: list[float] = []
        self.jobs += len(jobs)
        for start in range(0, len(jobs), size):
            number = first + start
            stopped = self.runs and isinstance(self.runs[-1].error, InterruptedRunError)
            if stopped or self.stop():
                error = InterruptedRunError("interrupted")
                self._leave_out(jobs[start:], self._names(jobs[start:], number), number, error)
                break
            if self._serial and len(jobs) > 1:
                left = sum(times) / len(times) * (len(jobs) - start) if times else None
                rest = "" if left is None else f"; about {left:.0f} s left for all"
                self._tell(f"run {start + 1} of {len(jobs)}{rest}")
            begun = time.monotonic()
            results += self._launch(jobs[start : start + size], number)
            if (spent := time.monotonic() - begun) > _AT_ONCE:
                times.append(spent)
        return results

    def take_up(self, runs: Iterable[SweepRun]) -> None:
        """Compare these runs, too, which were finished before."""
        self.runs += runs

    def raise_errors(self) -> None:
        """Raise InterruptedRunError if the sweep was stopped, else the first error of a job."""
        errors = [run.error for run in self.runs if run.error is not None]
        if self.stop() or any(isinstance(e, InterruptedRunError) for e in errors):
            raise InterruptedRunError("interrupted")
        if errors:
            raise errors[0]

    def _launch(self, jobs: Sequence[Job], first: int) -> Sequence[JobResult]:
        names = self._names(jobs, first)
        try:
            results = self._launcher(jobs, names, first)
        except BaseException as error:  # a second Ctrl-C, or a worker process that was killed
            stopped = self.stop() or isinstance(error, KeyboardInterrupt)
            cause = InterruptedRunError("interrupted") if stopped else error
            self._leave_out(jobs, names, first, cause)
            if stopped and isinstance(error, Exception):
                raise cause from error
            raise
        self.runs += [
            sweep_run(first + i, self._values(job), found.folder, found.error)
            for i, (job, found) in enumerate(zip(jobs, results, strict=True))
        ]
        return results

    def _leave_out(
        self, jobs: Sequence[Job], names: Sequence[str], first: int, error: BaseException
    ) -> None:
        """Record the runs of jobs that did not return, if the names of their folders are known."""
        self.runs += [
            unreturned_run(first + i, self._values(job), self.folder.absolute() / name, error)
            for i, (job, name) in enumerate(zip(jobs, names, strict=False))
        ]

    def _names(self, jobs: Sequence[Job], first: int) -> list[str]:
        """Return the folder name of each job; none if the launcher names them."""
        if not (self._named and self.swept):
            return []
        return [folder_name(first + i, self._values(job)) for i, job in enumerate(jobs)]

    def _values(self, job: Job) -> dict[str, str]:
        """Return the value of each swept key."""
        values = dict(override.partition("=")[::2] for override in job)
        return {key.lstrip("+~"): values[key] for key in self.swept if key in values}
