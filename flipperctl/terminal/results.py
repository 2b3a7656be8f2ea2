"""What ``flipperctl eval`` prints: tables or one JSON document, and what makes them worth less."""

from __future__ import annotations

import sys

from flipperctl.evaluation.results import EvaluationResult
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.evaluation import comparisons, search_lines, table
from flipperctl.terminal.streams import print_note


def print_result(result: EvaluationResult, label: str | None) -> None:
    """Print the tables with the policy's ``label``, or the JSON document if it is None."""
    for scene in result.scenes:
        if scene.is_one_drive:
            print_note(
                f"{scene.terrain}: all {len(scene.episodes)} episodes are one and the same "
                "drive, since nothing differs between them; their intervals mean nothing "
                "(episode.start_noise, perception.noise, randomise or conditions=varied "
                "make them differ)"
            )
    if label is None:
        print(result.to_json())
    else:
        _print_tables(result, label)
    sys.stdout.flush()


def _print_tables(result: EvaluationResult, label: str) -> None:
    out = console()
    for shown in (table(result, label), *comparisons(result)):
        shown.print(out)
    conditions = condition_lines((s.terrain, s.seed, s.conditions) for s in result.scenes)
    print_lines(out, (*search_lines(result), *conditions))
