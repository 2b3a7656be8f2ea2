"""A finished run, as ``train`` returns it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flipperctl.results import METRICS
from flipperctl.scripting.frames import data_frame
from flipperctl.scripting.policy import LoadedPolicy, load
from flipperctl.training.events import read_rows

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class Run:
    """A training that is finished, and its files."""

    directory: Path
    """The run directory: configuration, checkpoints, metrics."""
    summary: Mapping[str, Any] = field(repr=False)
    """Contents of ``summary.json``: the best validation, and how long the training took."""

    def __fspath__(self) -> str:
        return str(self.directory)

    def metrics(self) -> list[dict[str, float | str | None]]:
        """Return the rows of ``metrics.csv``: one for each episode and each validation.

        ``kind`` is ``episode`` or ``validation``; a number that a row lacks is None.
        """
        rows = read_rows(self.directory / METRICS)
        return [{name: _value(cell) for name, cell in row.items()} for row in rows]

    def metrics_frame(self) -> DataFrame:
        """Return the rows of ``metrics.csv`` as a data frame of pandas.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(self.metrics())

    def policy(self) -> LoadedPolicy:
        """Return the best policy of the run, ready to act.

        Raises:
            CheckpointError: its checkpoint was deleted or damaged.
        """
        return load(self.directory)


def _value(cell: str) -> float | str | None:
    """Return the number in a cell, None if it is empty, else its text."""
    if not cell:
        return None
    for number in (int, float):
        try:
            return number(cell)
        except ValueError:
            continue
    return cell
