"""The progress of trainings and evaluations: the commands' own, or in a notebook that of a cell."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.terminal.progress import Rate, episodes_progress, state_text, validation_text
from flipperctl.terminal.streams import print_note
from flipperctl.terminal.training import reports
from flipperctl.training.run import Reports

_WIDTH = 24
"""Characters of a bar [-]."""
_PERIOD = 0.2
"""Least time between two updates of a cell [s]."""


def is_running() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


class _Cell:
    """One output of the cell that runs: a bar, and lines below it."""

    def __init__(self, unit: str) -> None:
        from IPython import display

        show: Any = display.display  # without annotations
        self._unit, self._shown = unit, 0.0
        self._handle: Any = show({"text/plain": ""}, raw=True, display_id=True)

    def bar(
        self, done: float, total: int, state: str, below: Sequence[str] = (), *, now: bool = False
    ) -> None:
        """Move the bar, unless it has just moved and ``now`` is False."""
        if now or time.perf_counter() - self._shown >= _PERIOD:
            self._shown = time.perf_counter()
            full = min(_WIDTH, int(_WIDTH * done / max(1, total)))
            bar = "█" * full + "░" * (_WIDTH - full)
            self.text("\n".join([f"{bar} {done:.0f}/{total} {self._unit}  {state}", *below]))

    def text(self, text: str) -> None:
        """Show the text in place of the bar."""
        self._handle.update({"text/plain": text}, raw=True)


class TrainingCell:
    """A bar with the state of a training, and below it the validations and notes."""

    def __init__(self, total: int, done: int) -> None:
        """``total`` and ``done`` are decisions."""
        self._total, self._done, self._state = total, done, ""
        self._rate, self._cell, self._lines = Rate(), _Cell("decisions"), list[str]()
        self.close()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Move the bar."""
        self._done = row["decision"]
        self._rate.take(self._done)
        left = self._rate.left_text(self._done, self._total)
        self._state = "  ".join(filter(None, [left, state_text(row, self._rate.per_second)]))
        self._cell.bar(self._done, self._total, self._state, self._lines)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Add a line below the bar."""
        self.note(validation_text(row))

    def note(self, text: str) -> None:
        """Add a line below the bar."""
        self._lines.append(text)
        self.close()

    def close(self) -> None:
        """Show the last state."""
        self._cell.bar(self._done, self._total, self._state, self._lines, now=True)


def _episodes_in_a_cell() -> Progress:
    """Return a bar for some episodes after the other; it is empty between them and at the end."""
    cell = _Cell("episodes")

    @contextmanager
    def progress(label: str, total: int) -> Iterator[Callable[[float], None]]:
        cell.bar(0, total, label)
        try:
            yield lambda done: cell.bar(done, total, label)
        finally:
            cell.text("")

    return progress


def training_reports(shown: bool) -> Reports:
    """Return the reports that show a training."""
    if not shown:
        return replace(reports(), listeners=(), tell=lambda text: None)
    return replace(reports(), listeners=[TrainingCell]) if is_running() else reports()


def episodes(shown: bool) -> Progress:
    """Return what shows the episodes of an evaluation."""
    if not shown:
        return no_progress
    return _episodes_in_a_cell() if is_running() else episodes_progress


def notes(shown: bool) -> Callable[[str], None]:
    """Return a function that prints a line on stderr."""
    return print_note if shown else lambda text: None
