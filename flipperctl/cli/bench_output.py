"""Progress and result tables of ``flipperctl bench``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from flipperctl.cli.console import console

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


def tables(document: dict[str, Any]) -> Iterator[Table]:
    """Yield one table per measure: medians with quartiles, then ratios."""
    limit = document["settings"]["limit"]
    for name, found in document["measures"].items():
        table = Table(title=f"{name}: {found['about']}", title_justify="left", min_width=60)
        table.add_column("quantity")
        for heading in ("median", "quartiles", "unit"):
            table.add_column(heading, justify="right" if heading != "unit" else "left")
        for what, q in found["quantities"].items():
            late = f"not within {limit:g} s" if name == "solve" else "–"
            median = late if q["median"] is None else number(q["median"])
            table.add_row(escape(what), median, _range(q), escape(q["unit"]))
        if found["ratios"]:
            table.add_section()
        for what, r in found["ratios"].items():
            ratio = "–" if r["ratio"] is None else number(r["ratio"])
            table.add_row(escape(what), ratio, _range(r), "×")
        yield table


def number(value: float) -> str:
    """Return a number with three significant digits, as an integer from 100 upwards."""
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
