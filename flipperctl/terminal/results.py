"""The output of ``flipperctl eval``: tables or one JSON document, and a warning if they mislead."""

from __future__ import annotations

from flipperctl.evaluation.results import EvaluationResult
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.document import show
from flipperctl.terminal.evaluation import (
    comparisons,
    group_tables,
    risk_lines,
    search_lines,
    table,
)
from flipperctl.terminal.published import published_table
from flipperctl.terminal.streams import print_note


def print_result(result: EvaluationResult, label: str | None) -> None:
    """Print the tables with the policy's ``label``, or the JSON document if ``label`` is None."""
    told: set[str] = set()  # once for all methods
    for scene in result.scenes:
        if scene.has_identical_episodes and not (
            scene.name.method and scene.conditions.hash in told
        ):
            told.add(scene.conditions.hash)
            print_note(
                f"{scene.terrain}: all {len(scene.episodes)} episodes are identical, since nothing "
                "is random; their intervals are meaningless (episode.start_noise, "
                "perception.noise, randomise or conditions=varied make episodes differ)"
            )
    show(result.to_dict(), lambda: _print_tables(result, label or ""), as_json=label is None)


def _print_tables(result: EvaluationResult, label: str) -> None:
    out = console()
    for shown in (table(result, label), *comparisons(result), *group_tables(result)):
        shown.print(out)
    if beside := published_table(result, label):
        beside.print(out)
    conditions = condition_lines((s.terrain, s.seed, s.conditions) for s in result.scenes)
    print_lines(out, (*search_lines(result), *risk_lines(result), *conditions))
