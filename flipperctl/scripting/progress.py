"""The progress of trainings and evaluations: the commands' own, or in a notebook that of a cell."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
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
    """One output of the cell that runs."""

    def __init__(self) -> None:
        from IPython.display import display

        self._handle: Any = display({"text/plain": ""}, raw=True, display_id=True)
        self._shown = 0.0

    def show(self, text: Callable[[], str], *, now: bool = False) -> None:
        """Replace the text, unless the last one is newer than ``_PERIOD`` and ``now`` is False."""
        if now or time.perf_counter() - self._shown >= _PERIOD:
            self._shown = time.perf_counter()
            self._handle.update({"text/plain": text()}, raw=True)


class TrainingCell:
    """A bar with the state of a training, and below it the validations and notes."""

    def __init__(self, total: int, done: int) -> None:
        """``total`` and ``done`` are decisions."""
        self._total, self._done = total, done
        self._rate = Rate()
        self._state = ""
        self._lines: list[str] = []
        self._cell = _Cell()
        self._cell.show(self._text)

    def episode(self, row: Mapping[str, Any]) -> None:
        """Move the bar."""
        self._done = row["decision"]
        self._rate.take(self._done)
        state = state_text(row, self._rate.per_second)
        left = self._rate.left_text(self._done, self._total)
        self._state = "  ".join(filter(None, [left, state]))
        self._cell.show(self._text)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Add a line below the bar."""
        self.note(validation_text(row))

    def note(self, text: str) -> None:
        """Add a line below the bar."""
        self._lines.append(text)
        self._cell.show(self._text, now=True)

    def close(self) -> None:
        """Show the last state."""
        self._cell.show(self._text, now=True)

    def _text(self) -> str:
        bar = f"{_bar(self._done, self._total)} {self._done}/{self._total} decisions  {self._state}"
        return "\n".join([bar, *self._lines])


class EpisodesCell:
    """A bar for some episodes after the other; it is empty between them and at the end."""

    def __init__(self) -> None:
        self._cell: _Cell | None = None

    @contextmanager
    def __call__(self, label: str, total: int) -> Iterator[Callable[[float], None]]:
        """Show a bar; yield a function to call with the number of finished episodes."""
        cell = self._cell = self._cell or _Cell()

        def report(done: float) -> None:
            cell.show(lambda: f"{_bar(done, total)} {done:.0f}/{total} episodes  {label}")

        report(0)
        try:
            yield report
        finally:
            cell.show(str, now=True)


def _bar(done: float, total: int) -> str:
    full = min(_WIDTH, int(_WIDTH * done / max(1, total)))
    return "█" * full + "░" * (_WIDTH - full)


def training_reports(shown: bool) -> Reports:
    """Return the reports that show a training."""
    if not shown:
        return Reports()
    return Reports([TrainingCell], print_note) if is_running() else reports()


def episodes(shown: bool) -> Progress:
    """Return what shows the episodes of an evaluation."""
    if not shown:
        return no_progress
    return EpisodesCell() if is_running() else episodes_progress


def notes(shown: bool) -> Callable[[str], None]:
    """Return a function that prints a line on stderr."""
    return print_note if shown else lambda text: None
