"""The tables of ``flipperctl eval``.

In: the result of an evaluation. Out: a table of its scenes, and one of the differences to each
baseline.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from rich.markup import escape
from rich.table import Table

from flipperctl.cli.swing import HEADING, PAPERS_HEADING
from flipperctl.env.measures import Measure
from flipperctl.evaluation.episode import further_measures
from flipperctl.evaluation.results import (
    BaselineResult,
    Differences,
    EvaluationResult,
    Interval,
    SceneResult,
    Summary,
)
from flipperctl.evaluation.tables import FEWEST, interval_text


def table(result: EvaluationResult) -> Table:
    """Return a table with a row per scene, and a dim row for each part of a mix."""
    title = result.controller
    if result.interruption is not None:
        title = f"{title} ({result.interruption.text})"
    found = Table(title=escape(title), title_justify="left")
    passable = any(scene.summary.passable for scene in result.scenes)
    success = ["success", *(["passable", "of these"] if passable else [])]
    for heading in ("terrain", "episodes", *success, "outcomes", HEADING, PAPERS_HEADING):
        found.add_column(escape(heading))
    for heading in ("t_cost [s]", "largest pitch [rad]", "flipper travel [rad]"):
        found.add_column(escape(heading))
    for measure in _further():
        found.add_column(escape(measure.heading))
    for name, scene in _named(result):
        found.add_row(*_cells(name, scene.summary))
        for label, part in scene.summary.parts.items():
            found.add_row(*_cells(f"  {label}", part), style="dim")
    return found


def comparisons(result: EvaluationResult) -> Iterator[Table]:
    """Yield a table of the paired differences to each baseline.

    After an interruption, the last scene may lack baselines.
    """
    for index, _ in enumerate(result.scenes[0].baselines):
        have = [(n, scene) for n, scene in _named(result) if index < len(scene.baselines)]
        yield _comparison([(name, scene.baselines[index]) for name, scene in have])


def _comparison(compared: list[tuple[str, BaselineResult]]) -> Table:
    baseline = compared[0][1].controller
    title = f"difference to {baseline} on the same episodes, where both reached the finish"
    found = Table(title=title, title_justify="left")
    swings = (f"Δ {HEADING}", f"Δ {PAPERS_HEADING}")
    theirs = (f"{baseline}: success", f"{baseline}: {HEADING}")
    for heading in ("terrain", "pairs", *theirs, *swings, "Δ t_cost [s]"):
        found.add_column(escape(heading))
    for name, other in compared:
        found.add_row(*_difference_cells(name, other.summary, other.difference))
        for label, part in other.difference.parts.items():
            cells = _difference_cells(f"  {label}", other.summary.parts[label], part)
            found.add_row(*cells, style="dim")
    return found


def search_lines(result: EvaluationResult) -> Iterator[str]:
    """Yield a line for each scene whose policy searched: means of numbers, counts of words."""
    for name, scene in _named(result):
        parts = []
        for key, value in scene.summary.search.items():
            if isinstance(value, Mapping):
                counts = (f"{word} {count}" for word, count in value.items())
                parts.append(f"{key}: {', '.join(counts)}")
            else:
                parts.append(f"{key} {value:.6g}")
        if parts:
            yield f"search on {name}, means: {'; '.join(parts)}"


def _named(result: EvaluationResult) -> Iterator[tuple[str, SceneResult]]:
    """Yield each scene and its terrain, with the conditions' hash if the terrain has several."""
    counts = Counter(scene.terrain for scene in result.scenes)
    for scene in result.scenes:
        alone = counts[scene.terrain] == 1
        yield scene.terrain if alone else f"{scene.terrain} {scene.conditions.hash}", scene


def _cells(name: str, summary: Summary) -> list[str]:
    fair = summary.passable
    counts = summary.outcomes.container()
    reached, episodes = summary.outcomes.reached, summary.episodes
    return [
        name,
        str(episodes),
        _rate_text(summary.success),
        *([str(fair.episodes), _rate_text(fair.success)] if fair else []),
        " ".join(f"{outcome} {count}" for outcome, count in counts.items() if count),
        interval_text(summary.pitch_variation_100hz, reached),
        interval_text(summary.pitch_variation, reached),
        interval_text(summary.t_cost, reached, 1),
        interval_text(summary.max_pitch, episodes),
        interval_text(summary.flipper_travel, reached),
        *(
            interval_text(
                summary.further[measure.name],
                reached if measure.reached_only else episodes,
                measure.digits,
            )
            for measure in _further()
        ),
    ]


def _further() -> list[type[Measure]]:
    """Return the further measures that have a heading."""
    return [measure for measure in further_measures() if measure.heading]


def _difference_cells(name: str, other: Summary, difference: Differences) -> list[str]:
    swing = difference.pitch_variation_100hz
    pairs = swing.episodes if swing else 0
    return [
        name,
        str(pairs),
        _rate_text(other.success),
        interval_text(other.pitch_variation_100hz, other.outcomes.reached),
        interval_text(swing, pairs),
        interval_text(difference.pitch_variation, pairs),
        interval_text(difference.t_cost, pairs, 1),
    ]


def _rate_text(success: Interval | None) -> str:
    """Return a success rate, whose interval is known from the first episode on."""
    return interval_text(success, FEWEST, 3)
