"""The result of an evaluation, with its tables and data frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from flipperctl.evaluation.files import episode_rows
from flipperctl.evaluation.results import EvaluationResult
from flipperctl.evaluation.tables import interval_text, scene_rows
from flipperctl.scripting.frames import data_frame
from flipperctl.terminal.results import print_result

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False)
class Evaluation(EvaluationResult):
    """Policies on their scenes, as typed values in ``scenes``; SI units throughout.

    ``to_dict()`` returns plain data, the document of ``flipperctl eval --json``.
    """

    def __repr__(self) -> str:
        scenes = ", ".join(
            f"{s.terrain}: success {interval_text(s.summary.success)}" for s in self.scenes
        )
        return f"Evaluation({self.controller}; {scenes})"

    def show(self) -> None:
        """Print the tables that ``flipperctl eval`` prints."""
        print_result(self, self.controller)

    def scenes_frame(self) -> DataFrame:
        """Return a row for each scene and method: means with their 95 % intervals.

        The columns are those of ``table.csv``, not rounded; the methods of a scene are the policy
        and its baselines.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(scene_rows(self))

    def episodes_frame(self) -> DataFrame:
        """Return a row for each episode of the policy and its baselines, as in ``episodes.csv``.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(episode_rows(self))
