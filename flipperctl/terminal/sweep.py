"""The table that compares the runs of a sweep, on stderr."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flipperctl.session import quote_path
from flipperctl.show import NONE, Column, Table, print_table
from flipperctl.terminal.console import console
from flipperctl.terminal.progress import HEADING, PAPERS_HEADING
from flipperctl.training.sweep import FILE, SweepRun

_ROWS = 40
"""Largest number of runs in the table; the file holds all."""
_COLUMNS = (
    Column("success", "success"),
    Column("pitch_variation_100hz", HEADING, 3),
    Column("pitch_variation", PAPERS_HEADING, 3),
    Column("t_cost", "t_cost [s]", 1),
    Column("decisions", "decisions"),
    Column("seconds", "seconds", 0),
    Column("folder", "folder", named=True),
)


def print_comparison(folder: Path, runs: Sequence[SweepRun]) -> None:
    """Print a row for each run of the sweep in ``folder``, and the path of the file.

    Print nothing without runs.
    """
    if not runs:
        return
    keys = list(dict.fromkeys(key for run in runs for key in run.swept))
    columns = [*(Column(f"swept {key}", key, named=True) for key in keys), *_COLUMNS]
    rows = []
    for run in runs[:_ROWS]:
        row = run.row()
        success = row["success_rate"]
        rows.append(
            row
            | {f"swept {key}": run.swept.get(key, "") for key in keys}
            | {
                "success": NONE if success is None else f"{success:.1%}",
                "folder": run.folder.name + ("" if run.state == "finished" else f" ({run.state})"),
            }
        )
    out = console(stderr=True)
    print_table(Table(columns, rows, f"{quote_path(folder)}: {len(runs)} runs"), out)
    left = len(runs) - _ROWS
    more = f"{left} more runs and the table" if left > 0 else "the table"
    text = f"{more}: {quote_path(folder / FILE)}"
    out.print(text, highlight=False, markup=False, soft_wrap=True)
