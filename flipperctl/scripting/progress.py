"""The progress of trainings and evaluations: the commands' own, or in a notebook that of a cell."""

from __future__ import annotations

from collections.abc import Callable

from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.runs.training import Reports
from flipperctl.scripting import notebook
from flipperctl.terminal.progress import episodes_progress
from flipperctl.terminal.streams import print_note
from flipperctl.terminal.training import reports


def training_reports(shown: bool) -> Reports:
    """Return the reports that show a training."""
    if not shown:
        return Reports()
    return Reports([notebook.TrainingCell], print_note) if notebook.is_running() else reports()


def episodes(shown: bool) -> Progress:
    """Return what shows the episodes of an evaluation."""
    if not shown:
        return no_progress
    return notebook.EpisodesCell() if notebook.is_running() else episodes_progress


def notes(shown: bool) -> Callable[[str], None]:
    """Return a function that prints a line on stderr."""
    return print_note if shown else lambda text: None
