"""Compare the runs of a sweep.

In: the runs, after their jobs returned. Out: ``sweep.csv`` with a row for each.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.files import write_csv
from flipperctl.results import SUMMARY, holds_run
from flipperctl.runs.summary import of_reached

FILE = "sweep.csv"


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep, after its job returned."""

    job: int
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
        """Return the row of ``sweep.csv``; the measures are those of the best validation."""
        best = of_reached(self.summary.get("best") or {})
        measures = ("success_rate", "pitch_variation_100hz", "pitch_variation", "t_cost")
        return {
            "job": self.job,
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
    failure = FlipperctlError(repr(error))
    ended = error if error is None or isinstance(error, Exception) else failure
    return SweepRun(number, swept, folder, ended, _summary(folder))


def unreturned_run(
    number: int, swept: dict[str, str], folder: Path, error: BaseException
) -> SweepRun:
    """Return a run, read from its folder, whose launcher failed with ``error``."""
    found = sweep_run(number, swept, folder, error)
    return replace(found, error=None) if found.summary.get("finished") else found


def _summary(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / SUMMARY).read_text())
    except (OSError, ValueError):  # the run failed before it wrote one, or is on another machine
        return {}
    return found if isinstance(found, dict) else {}


def write_comparison(folder: Path, runs: Sequence[SweepRun]) -> list[SweepRun]:
    """Write ``sweep.csv`` into the sweep's ``folder``; return the runs that it compares.

    A run that was refused because its folder holds another run is left out.
    """
    compared = [run for run in runs if not (run.summary and isinstance(run.error, RequestError))]
    if compared:
        rows = _earlier_rows(folder, compared) + [run.row() for run in compared]
        write_csv(folder / FILE, sorted(rows, key=_job_number))
    return compared


def _job_number(row: Mapping[str, Any]) -> int:
    number = str(row.get("job", ""))
    return int(number) if number.isdecimal() else 0


def _earlier_rows(folder: Path, runs: Sequence[SweepRun]) -> list[dict[str, Any]]:
    """Return the rows of an earlier sweep in the folder, without those that ``runs`` replace.

    The folder may have been moved since, so that rows are known by the places of their runs in it.
    A damaged file has no rows.
    """
    replaced = [_place(run.folder, folder) for run in runs]
    try:
        with (folder / FILE).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return []
    places = [Path(row.get("folder") or "").parts for row in rows]
    return [
        row
        for row, parts in zip(rows, places, strict=True)
        if not any(parts[-len(place) :] == place for place in replaced)
    ]


def _place(run: Path, folder: Path) -> tuple[str, ...]:
    """Return the parts of a run's path below the folder of its sweep; all parts elsewhere."""
    run, folder = run.absolute(), folder.absolute()
    return (run.relative_to(folder) if run.is_relative_to(folder) else run).parts
