"""The jobs of a sweep or a search: launched, stopped together, and compared.

In: jobs, each a list of overrides, and a launcher. Out: a run directory for each job, named after
the swept values, ``sweep.csv`` in the sweep's folder with a row for each, and the result of each
job. One Ctrl-C stops every run, in any process in which a launcher trains it.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flipperctl.checkpoint.results import hold, holds_run, is_dead, names, summary_of
from flipperctl.config.words import key_of
from flipperctl.env.metrics import with_both_names
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError, RunHeldError
from flipperctl.process.session import command, interrupts
from flipperctl.text.files import make_folder, read_csv, write_csv

_LONGEST = 120
"""Largest length of a folder's name in characters; file systems allow 255 bytes."""


def folder_name(number: int, swept: Mapping[str, str]) -> str:
    """Return the folder name of a sweep's run, as in ``0_seed=1,terrain=step``.

    Characters that are special to a shell or a file system become ``_``; a long name is cut.
    """
    words = ",".join(f"{key}={_short(value)}" for key, value in swept.items())
    name = re.sub(r"[^A-Za-z0-9_.,=+-]+", "_", f"{number}_{words}")
    return name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "_"


def _short(value: str) -> str:
    """Return a number with five digits, since a search samples sixteen."""
    try:
        return value if len(value) <= 8 else f"{float(value):.5g}"
    except ValueError:
        return value


_MARK = ".sweep.stop"


@contextlib.contextmanager
def stopping(folder: Path) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the sweep in the locked ``folder`` must stop."""
    mark = folder / _MARK
    mark.unlink(missing_ok=True)  # of a sweep that was killed
    try:
        with interrupts("finishing the episodes and saving …", mark.touch):
            yield mark.exists
    finally:
        mark.unlink(missing_ok=True)


def stop_of(folder: Path, sweeper: tuple[str, int]) -> Callable[[], bool]:
    """Return a function that returns whether the job must stop: with its sweep, or ``sweeper``.

    ``sweeper``: the process that waits for the job (``results.holder``), which may have died.
    """
    mark = folder / _MARK
    return lambda: mark.exists() or is_dead(sweeper)


REACHED = ("pitch_variation_100hz", "pitch_variation_decisions", "t_cost")
"""Measures of a validation that are means over the episodes that reached the finish."""


def of_reached(validation: Mapping[str, Any]) -> dict[str, Any]:
    """Return the measures of a validation, with None in ``REACHED`` if no episode finished.

    The files have the means over all episodes there, by which validations are ranked.
    """
    if validation.get("success_rate"):
        return dict(validation)
    return {name: None if name in REACHED else v for name, v in validation.items()}


FILE = "sweep.csv"


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep, after its job returned."""

    number: int
    swept: dict[str, str]
    """The swept overrides, key → value."""
    folder: Path
    error: Exception | None
    summary: dict[str, Any]
    """Contents of ``summary.json``; empty if there is none."""

    @property
    def state(self) -> str:
        """One of finished, interrupted, not begun and failed; the error has its own column."""
        if self.summary.get("finished"):
            return "finished"
        if not isinstance(self.error, InterruptedRunError):
            return "failed"
        return "interrupted" if holds_run(self.folder) else "not begun"

    def row(self) -> dict[str, Any]:
        """Return the row of ``sweep.csv``, with the measures of the best validation."""
        best = of_reached(with_both_names(self.summary.get("best") or {}))
        measures = ("success_rate", "pitch_variation_100hz", "pitch_variation_decisions", "t_cost")
        return {
            "run": self.number,
            **self.swept,
            **{name: best.get(name) for name in measures},
            "best_decision": best.get("decision"),
            "decisions": self.summary.get("decisions"),
            "seconds": self.summary.get("seconds"),
            "state": self.state,
            "error": str(self.error or ""),
            "folder": str(self.folder),
        }


def sweep_run(
    number: int, swept: dict[str, str], folder: Path, error: BaseException | None
) -> SweepRun:
    """Return a run, read from its folder; ``error`` is the one that ended its job, if any."""
    if error is not None and not isinstance(error, Exception):
        error = FlipperctlError(repr(error))
    return SweepRun(number, swept, folder, error, summary_of(folder))


def write_comparison(
    folder: Path, runs: Sequence[SweepRun], earlier: Sequence[Mapping[str, Any]] = ()
) -> list[SweepRun]:
    """Write ``sweep.csv`` into the sweep's ``folder``; return the runs that it compares.

    ``earlier``: the rows that the file has. A run that was refused because its folder holds another
    run is left out.
    """
    compared = [run for run in runs if not (run.summary and isinstance(run.error, RequestError))]
    if compared:
        rows = [*_not_replaced(earlier, folder, compared), *(run.row() for run in compared)]
        write_csv(folder / FILE, sorted(rows, key=_run_number))
    return compared


def _run_number(row: Mapping[str, Any]) -> int:
    number = str(row.get("run", ""))
    return int(number) if number.isdecimal() else 0


def _not_replaced(
    rows: Iterable[Mapping[str, Any]], folder: Path, runs: Sequence[SweepRun]
) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of an earlier sweep in the folder that ``runs`` do not replace.

    The folder may have been moved since, so that rows are known by the places of their runs in it.
    """
    here, folders = folder.absolute(), [run.folder.absolute() for run in runs]
    replaced = [(p.relative_to(here) if p.is_relative_to(here) else p).parts for p in folders]
    for row in rows:
        parts = Path(row["folder"]).parts
        if not any(parts[-len(place) :] == place for place in replaced):
            yield row


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
        words: Sequence[str] = (),
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """``folder`` is that of the sweep; ``show`` is called with it and the runs at the end.

        ``named``: whether runs are named after the swept values. ``serial``: whether jobs are
        launched one by one, so that none begins after Ctrl-C; ``tell`` is then called with a line
        before each of several. ``numbered``: whether another folder beside ``folder`` is taken if
        another process works in it. ``words``: those of the command that runs the sweep.
        """
        self.folder, self._numbered = folder, numbered
        self._launcher, self._show, self._named, self._serial = launch, show, named, serial
        self._tell, self._words = tell, words
        self.stop: Callable[[], bool] = lambda: False
        """Called before each launch; once it returns True, no further job begins."""
        self.jobs = 0
        """Number of requested jobs."""
        self.swept: list[str] = []
        """Keys that the sweep varies."""
        self.runs: list[SweepRun] = []

    def command(self) -> str:
        """Return the command that continues the sweep, quoted for the shell."""
        typed = [w for w in self._words if w != "--multirun" and key_of(w) != "hydra.sweep.dir"]
        inside = self.folder.is_relative_to(Path.cwd())
        short = os.path.relpath(self.folder) if inside else str(self.folder)
        return command("train", "-m", *typed, "--output", short)

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Lock the sweep's folder, stop jobs after Ctrl-C, and compare the runs at the end."""
        with contextlib.ExitStack() as stack:
            # Where another process works in the folder, the next free name is taken, if allowed.
            for place in names(self.folder, numbered=self._numbered):
                try:
                    stack.enter_context(hold(make_folder(place), "sweep", "in use"))
                    self.folder = place
                    break
                except RunHeldError:
                    if not self._numbered:
                        raise
            table = self.folder / FILE  # it is read before any job, since it is written anew
            earlier = read_csv(table, ("run", "folder"), {"job": "run"}) if table.exists() else []
            try:
                with stopping(self.folder) as self.stop:
                    yield
            finally:
                self._show(self.folder, write_comparison(self.folder, self.runs, earlier))

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
            # After an interrupt no job begins; the rest appear as not begun.
            stopped = self.runs and isinstance(self.runs[-1].error, InterruptedRunError)
            if stopped or self.stop():
                error = InterruptedRunError("interrupted")
                self._leave_out(jobs[start:], self._names(jobs[start:], number), number, error)
                break
            # The time left follows from jobs that were trained in this start.
            if self._serial and len(jobs) > 1:
                left = sum(times) / len(times) * (len(jobs) - start) if times else None
                rest = "" if left is None else f"; about {left:.0f} s left for all"
                self._tell(f"run {start + 1} of {len(jobs)}{rest}")
            begun = time.monotonic()
            results += self._launch(jobs[start : start + size], number)
            if (spent := time.monotonic() - begun) > _AT_ONCE:
                times.append(spent)
        return results

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
        # Each job's run is read back from its folder, since a launcher may use other processes.
        self.runs += [
            sweep_run(first + i, self._values(job), result.folder, result.error)
            for i, (job, result) in enumerate(zip(jobs, results, strict=True))
        ]
        return results

    def _leave_out(
        self, jobs: Sequence[Job], names: Sequence[str], first: int, error: BaseException
    ) -> None:
        """Record the runs of jobs that did not return, if the names of their folders are known."""
        for i, (job, name) in enumerate(zip(jobs, names, strict=False)):
            folder = self.folder.absolute() / name
            run = sweep_run(first + i, self._values(job), folder, error)
            # A run that an earlier start has finished has no error.
            self.runs.append(replace(run, error=None) if run.summary.get("finished") else run)

    def _names(self, jobs: Sequence[Job], first: int) -> list[str]:
        """Return the folder name of each job; none if the launcher names them."""
        if not (self._named and self.swept):
            return []
        return [folder_name(first + i, self._values(job)) for i, job in enumerate(jobs)]

    def _values(self, job: Job) -> dict[str, str]:
        """Return the value of each swept key."""
        values = dict(override.partition("=")[::2] for override in job)
        return {key.lstrip("+~"): values[key] for key in self.swept if key in values}
