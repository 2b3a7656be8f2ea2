"""The output of ``flipperctl inspect results``: methods over their training seeds."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from flipperctl.evaluation.power import MOST
from flipperctl.evaluation.tables import interval_text
from flipperctl.studies.seed_results import Answer, Question
from flipperctl.studies.seed_table import Comparison, MethodRow
from flipperctl.terminal.console import console
from flipperctl.terminal.tables import Table


def print_notices(found: Answer) -> None:
    """Print on stderr what was left out."""
    for notice in found.evaluated.notices:
        print(f"warning: {notice}", file=sys.stderr)


def print_table(answer: Answer, picture: Path | None) -> None:
    """Print the methods, their comparisons, and the numbers of episodes that were asked for."""
    out, rows, episodes = console(), answer.rows, answer.evaluated.episodes
    scenes = ", ".join(f"{scene} {count}" for scene, count in episodes.items())
    title = (
        f"score: {answer.label}, {answer.price:.4g} where not reached; episodes of each seed: "
        f"{scenes}"
    )
    found = Table(("method", "seeds", "success", "mean score", "IQM", "mean of reached"), title)
    for row in rows:
        found.add(
            row.method,
            str(row.seeds),
            interval_text(row.success, 3),
            interval_text(row.score, 3),
            interval_text(row.iqm, 3),
            "–" if row.reached_mean is None else f"{row.reached_mean:.3f}",
        )
        for scene, score in row.by_scene.items() if len(episodes) > 1 else ():
            found.add(f"  {scene}", "", "", interval_text(score, 3), "", "", dim=True)
    for line in _price_warnings(rows):
        out.print(line, highlight=False, markup=False, soft_wrap=True)
    found.print(out)
    compared = [(row.method, row.comparison) for row in rows if row.comparison is not None]
    if compared:
        _comparisons(compared).print(out)
    several = any(row.seeds > 1 for row in rows)
    for line in (*_needed(compared, answer.question, several), *_warnings(rows)):
        out.print(line, highlight=False, markup=False, soft_wrap=True)
    if picture is not None:
        print(f"picture: {picture}")


def _comparisons(compared: Sequence[tuple[str, Comparison]]) -> Table:
    against = compared[0][1].against
    found = Table(
        (
            *("method", "Δ score", "p (Holm)", "Δ success", "p (Holm)"),
            *("improvement, seeds", "better, episodes"),
        ),
        f"compared with {against} on the same episodes; a smaller score is better",
    )
    for method, one in compared:
        found.add(
            method,
            interval_text(one.score, 3, sign="+"),
            _p_text(one.p_holm),
            interval_text(one.success, 3, sign="+"),
            _p_text(one.p_success_holm),
            f"{one.improvement:.3f}",
            interval_text(one.better, 3),
        )
    return found


def _p_text(p: float) -> str:
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def _needed(
    compared: Sequence[tuple[str, Comparison]], question: Question, several: bool
) -> Iterator[str]:
    """Yield how many episodes show a difference; ``several``: a method has several seeds."""
    others = ", not between the methods, whose other trainings differ" if several else ""
    for method, one in compared:
        for difference, what, number in (
            (question.detect, "the score", one.needed),
            (question.detect_success, "success", one.needed_success),
        ):
            if difference is not None:
                count = f"more than {MOST}" if number is None else str(number)
                yield (
                    f"{method}, {one.against}: {count} episodes show a difference of "
                    f"{difference:g} of {what} between these policies with a probability of 80 %"
                    f"{others}"
                )


def _price_warnings(rows: Sequence[MethodRow]) -> Iterator[str]:
    """Yield a line, above the table, for each method whose failures pay."""
    for row in rows:
        if row.above_price:
            yield (
                f"warning: {row.above_price} episodes that {row.method} reached cost more than one "
                "that is not reached, so that failing pays here; a higher --price is advised"
            )


def _warnings(rows: Sequence[MethodRow]) -> Iterator[str]:
    alone = [row.method for row in rows if row.trained and row.seeds == 1]
    if alone:
        yield (
            f"one training seed: {', '.join(alone)}; the interval is over episodes alone, and says "
            "nothing of other trainings of the method (docs/training_seeds.md)"
        )
    few = [row.method for row in rows if row.trained and 1 < row.seeds < 5]
    if few:
        yield (
            f"fewer than five training seeds: {', '.join(few)}; their intervals are wide, and too "
            "narrow all the same if a seed may be far worse than the others "
            "(docs/training_seeds.md)"
        )
