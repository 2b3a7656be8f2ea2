"""Compare the runs of a sweep: a table at its end, and ``sweep.csv`` with all of them."""

from __future__ import annotations

import contextlib
import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn

from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.files import write_csv
from flipperctl.runs.folder import SUMMARY, holds_run
from flipperctl.terminal.follow_up import quote_path
from flipperctl.terminal.pitch_variation import HEADING, PAPERS_HEADING

FILE = "sweep.csv"
_ROWS = 40
"""Largest number of runs in the table; the file holds all."""


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
        best = self.summary.get("best") or {}
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


def job_result(job: JobReturn) -> tuple[Any, Exception | None]:
    """Return the value that a job returned, or the error that ended it.

    ``return_value`` writes a line to stderr before it raises the error. That line is hidden,
    since the command shows the error itself.
    """
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return job.return_value, None
        except Exception as error:  # noqa: BLE001 (a job may fail in any way)
            return None, error


def sweep_run(job: JobReturn, number: int, swept: dict[str, str]) -> SweepRun:
    """Return the run that a job trained."""
    composed: Any = job.hydra_cfg
    folder = Path(composed.hydra.runtime.output_dir)
    return SweepRun(number, swept, folder, job_result(job)[1], _summary(folder))


def unreturned_run(
    number: int, swept: dict[str, str], folder: Path, error: BaseException
) -> SweepRun:
    """Return a run whose launcher was ended by ``error`` before it returned, from its folder."""
    summary = _summary(folder)
    failure = error if isinstance(error, Exception) else FlipperctlError(repr(error))
    return SweepRun(number, swept, folder, None if summary.get("finished") else failure, summary)


def _summary(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / SUMMARY).read_text())
    except (OSError, ValueError):  # the run failed before it wrote one, or is on another machine
        return {}
    return found if isinstance(found, dict) else {}


def compare(folder: Path, runs: Sequence[SweepRun]) -> None:
    """Write ``sweep.csv`` into the sweep's ``folder`` and print the table to stderr.

    A run that was refused since its folder holds another one is left out: the row is the other's.
    """
    runs = [run for run in runs if not (run.summary and isinstance(run.error, RequestError))]
    if not runs:
        return
    rows = _earlier_rows(folder / FILE, runs) + [run.row() for run in runs]
    write_csv(folder / FILE, sorted(rows, key=_job_number))
    _print(folder, runs)


def _job_number(row: Mapping[str, Any]) -> int:
    number = str(row.get("job", ""))
    return int(number) if number.isdecimal() else 0


def _earlier_rows(path: Path, runs: Sequence[SweepRun]) -> list[dict[str, Any]]:
    """Return the rows of an earlier sweep in the folder, without those that ``runs`` replace."""
    if not path.is_file():
        return []
    replaced = {str(run.folder) for run in runs}
    with path.open(newline="") as file:
        return [row for row in csv.DictReader(file) if row.get("folder") not in replaced]


def _print(folder: Path, runs: Sequence[SweepRun]) -> None:
    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

    keys = list(dict.fromkeys(key for run in runs for key in run.swept))
    numbers = ("success", HEADING, PAPERS_HEADING, "t_cost [s]", "decisions", "seconds")
    title = f"{quote_path(folder)}: {len(runs)} runs"
    table = Table([*keys, *numbers, "folder"], title, right=numbers, words=["folder"])
    for run in runs[:_ROWS]:
        row = run.row()
        table.add(
            *(run.swept.get(key, "") for key in keys),
            _number(row["success_rate"], ".1%"),
            _number(row["pitch_variation_100hz"], ".3f"),
            _number(row["pitch_variation"], ".3f"),
            _number(row["t_cost"], ".1f"),
            _number(row["decisions"], "d"),
            _number(row["seconds"], ".0f"),
            run.folder.name + ("" if run.state == "finished" else f" ({run.state})"),
        )
    out = console(stderr=True)
    table.print(out)
    left = len(runs) - _ROWS
    more = f"{left} more runs and the table" if left > 0 else "the table"
    text = f"{more}: {quote_path(folder / FILE)}"
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
