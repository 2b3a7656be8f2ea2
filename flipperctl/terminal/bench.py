"""Progress and result tables of measures."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from flipperctl.show import NONE, Column, Table, print_table
from flipperctl.terminal.console import console

_PLAIN_EVERY = 10.0  # [s]
_COLUMNS = (
    Column("what", "quantity", named=True),
    Column("median", "median"),
    Column("range", "quartiles"),
    Column("unit", "unit"),
)


class Bar:
    """A rich progress bar with the current step of a measure."""

    def __init__(self, measure: str) -> None:
        self._progress = Progress(
            TextColumn(f"[bold]{measure}[/]"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console(stderr=True),
            transient=True,
        )
        self._task = self._progress.add_task("", total=1.0)
        self._progress.start()

    def __call__(self, what: str, fraction: float) -> None:
        """Move the bar."""
        self._progress.update(self._task, completed=fraction, description=escape(what))

    def close(self) -> None:
        """Remove the bar from the terminal."""
        self._progress.stop()


class Lines:
    """Progress as a line every ten seconds."""

    def __init__(self, measure: str) -> None:
        self._measure = measure
        self._begun = self._last = time.perf_counter()

    def __call__(self, what: str, fraction: float) -> None:
        """Print a line if the last is ten seconds old."""
        now = time.perf_counter()
        if now - self._last < _PLAIN_EVERY:
            return
        self._last = now
        left = f", {(now - self._begun) * (1 / fraction - 1):.0f} s left" if fraction > 0 else ""
        print(f"{self._measure}: {fraction:.0%}{left}  {what}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Do nothing; lines need no clean-up."""


@contextmanager
def shown_progress(label: str) -> Iterator[Bar | Lines]:
    """Show a bar with the remaining time on a terminal, occasional lines elsewhere."""
    shown = Bar(label) if sys.stderr.isatty() else Lines(label)
    try:
        yield shown
    finally:
        shown.close()


def print_measures(document: dict[str, Any]) -> None:
    """Print one table per measure."""
    out = console()
    for table in tables(document):
        print_table(table, out)


def tables(document: dict[str, Any]) -> Iterator[Table]:
    """Yield one table per measure: medians with quartiles, then ratios.

    The text ``unfinished`` of a measure replaces a median that falls on an unfinished run.
    """
    for name, found in document["measures"].items():
        rows = [
            {
                "what": what,
                "median": _number(q["median"], found.get("unfinished", NONE)),
                "range": _range(q),
                "unit": q["unit"],
            }
            for what, q in found["quantities"].items()
        ]
        for at, (what, r) in enumerate(found["ratios"].items()):
            row = {"what": what, "median": _number(r["ratio"]), "range": _range(r), "unit": "×"}
            rows.append(row | {"line": at == 0})
        yield Table(_COLUMNS, rows, f"{name}: {found['about']}")


def _number(value: float | None, missing: str = NONE) -> str:
    return missing if value is None else number(value)


def number(value: float) -> str:
    """Return a number with three significant digits, or as an integer from 100 upwards."""
    if value == 0:
        return "0"
    if abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def _range(found: dict[str, Any]) -> str:
    if found["low"] is None and found["high"] is None:
        return NONE
    return f"{_number(found['low'])} … {_number(found['high'])}"
