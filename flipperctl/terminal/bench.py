"""Progress and result tables of measures."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from flipperctl.terminal.console import console
from flipperctl.terminal.tables import Table

_PLAIN_EVERY = 10.0  # [s]


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
    for table in tables(document):
        table.print(console())


def tables(document: dict[str, Any]) -> Iterator[Table]:
    """Yield one table per measure: medians with quartiles, then ratios.

    The text ``unfinished`` of a measure replaces a median that falls on an unfinished run.
    """
    for name, found in document["measures"].items():
        headings = ("quantity", "median", "quartiles", "unit")
        table = Table(headings, f"{name}: {found['about']}", right=["median", "quartiles"])
        for what, q in found["quantities"].items():
            median = found.get("unfinished", "–") if q["median"] is None else number(q["median"])
            table.add(what, median, _range(q), q["unit"])
        table.end_section()
        for what, r in found["ratios"].items():
            ratio = "–" if r["ratio"] is None else number(r["ratio"])
            table.add(what, ratio, _range(r), "×")
        yield table


def number(value: float) -> str:
    """Return a number with three significant digits, or as an integer from 100 upwards."""
    if value == 0:
        return "0"
    if abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def _range(found: dict[str, Any]) -> str:
    if found["low"] is None and found["high"] is None:
        return "–"
    low, high = ("–" if found[k] is None else number(found[k]) for k in ("low", "high"))
    return f"{low} … {high}"
