"""The result of an evaluation, with its tables and data frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from flipperctl.evaluation.evaluate import Interruption, PolicyError, Result
from flipperctl.evaluation.views.evaluation import csv_rows, parse_columns
from flipperctl.evaluation.views.summary import Document, rate_text
from flipperctl.runs.evaluation import episode_rows
from flipperctl.scripting.frames import data_frame
from flipperctl.terminal.results import print_result

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Policies on their scenes; SI units throughout."""

    result: Result
    """The plan and the episodes."""
    document: Document = field(compare=False)
    """Plain data: what ``flipperctl eval --json`` prints."""

    def __repr__(self) -> str:
        scenes = ", ".join(
            f"{s['terrain']}: success {rate_text(s['success'])}" for s in self.scenes
        )
        return f"Evaluation({self.document['controller']}; {scenes})"

    @property
    def scenes(self) -> list[Document]:
        """The results on each scene, as plain data (see ``to_dict``)."""
        found: list[Document] = self.document["scenes"]
        return found

    @property
    def interruption(self) -> Interruption | None:
        """How far the evaluation came before it was stopped; None if it was not."""
        return self.result.interruption

    @property
    def failures(self) -> tuple[PolicyError, ...]:
        """Policies that failed on a scene; their results are left out."""
        return self.result.failures

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: what ``flipperctl eval --json`` prints."""
        return self.document

    def show(self, columns: Sequence[str] = ()) -> None:
        """Print the tables that ``flipperctl eval`` prints, with further ``columns``."""
        print_result(self.result, self.document, parse_columns(",".join(columns) or None))

    def scenes_frame(self) -> DataFrame:
        """Return a row for each scene and policy: means with their 95 % intervals.

        The columns are those of ``table.csv``, not rounded.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(csv_rows(self.document))

    def episodes_frame(self) -> DataFrame:
        """Return a row for each episode of the policies and baselines, as in ``episodes.csv``.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(episode_rows(self.result))
