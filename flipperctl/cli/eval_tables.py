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


def table(result: EvaluationResult) -> Table:
    """Return a table with a row per scene, and a dim row for each part of a mix."""
    found = Table(title=result.controller, title_justify="left")
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
    """Yield a table of the paired differences to each baseline."""
    for index, _ in enumerate(result.scenes[0].baselines):
        yield _comparison([(n, scene.baselines[index]) for n, scene in _named(result)])


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
    return [
        name,
        str(summary.episodes),
        _format_interval(summary.success, 3),
        *([str(fair.episodes), _format_interval(fair.success, 3)] if fair else []),
        " ".join(f"{outcome} {count}" for outcome, count in counts.items() if count),
        _format_interval(summary.pitch_variation_100hz),
        _format_interval(summary.pitch_variation),
        _format_interval(summary.t_cost, 1),
        _format_interval(summary.max_pitch),
        _format_interval(summary.flipper_travel),
        *(
            _format_interval(summary.further[measure.name], measure.digits)
            for measure in _further()
        ),
    ]


def _further() -> list[type[Measure]]:
    """Return the further measures that have a heading."""
    return [measure for measure in further_measures() if measure.heading]


def _difference_cells(name: str, other: Summary, difference: Differences) -> list[str]:
    pairs = difference.pitch_variation_100hz
    return [
        name,
        str(pairs.episodes if pairs else 0),
        _format_interval(other.success, 3),
        _format_interval(other.pitch_variation_100hz),
        _format_interval(pairs),
        _format_interval(difference.pitch_variation),
        _format_interval(difference.t_cost, 1),
    ]


def _format_interval(interval: Interval | None, digits: int = 2) -> str:
    if interval is None:
        return "–"
    numbers = (interval.mean, interval.low, interval.high)
    mean, low, high = (f"{number:.{digits}f}" for number in numbers)
    return f"{mean} [{low}, {high}]"
