"""The table that compares the runs of a sweep, on stderr."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flipperctl.runs.comparison import FILE, SweepRun
from flipperctl.runs.follow_up import quote_path
from flipperctl.terminal.console import console
from flipperctl.terminal.pitch_variation import HEADING, PAPERS_HEADING
from flipperctl.terminal.tables import Table

_ROWS = 40
"""Largest number of runs in the table; the file holds all."""


def print_comparison(folder: Path, runs: Sequence[SweepRun]) -> None:
    """Print a row for each run of the sweep in ``folder``, and the path of the file.

    Print nothing without runs.
    """
    if not runs:
        return
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
