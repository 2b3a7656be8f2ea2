"""The tables of ``flipperctl eval``.

In: the result of an evaluation. Out: a table of its scenes, and a table of the differences to each
baseline.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from flipperctl.api import Measure
from flipperctl.env.metrics import heading, shown
from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.estimates import PairedSuccess
from flipperctl.evaluation.results import (
    BaselineResult,
    Differences,
    EvaluationResult,
    SceneResult,
    Summary,
)
from flipperctl.evaluation.risk import risk_text
from flipperctl.evaluation.sensing import counts
from flipperctl.evaluation.tables import interval_text
from flipperctl.terminal.groups import BOUND, group_table
from flipperctl.terminal.pitch_variation import HEADING, PAPERS_HEADING
from flipperctl.terminal.tables import Table

_CAUSES = "failures by cause"
_PASSABLE = ("passable", "of these", "beyond")
_FAILED = f"{HEADING} where not reached"


def table(result: EvaluationResult, label: str) -> Table:
    """Return a table with a row per scene, and a dim row for each part of a mix.

    ``label`` is the policy's. A column that is empty in every row is left out.
    """
    title = label if result.interruption is None else f"{label} ({result.interruption.text})"
    passable = any(scene.summary.passable for scene in result.scenes)
    failed = any(scene.summary.not_reached for scene in result.scenes)
    causes = any(counts(scene.episodes) for scene in result.scenes)
    bound = any(scene.summary.static_bound for scene in result.scenes)
    further = shown(scene.summary.further for scene in result.scenes)
    headings = [
        *("terrain", "episodes", "success", *(_PASSABLE if passable else ()), "outcomes"),
        *((_CAUSES,) if causes else ()),
        *(HEADING, *((BOUND,) if bound else ()), PAPERS_HEADING),
        *(*((_FAILED,) if failed else ()), "t_cost [s]"),
        *("largest pitch [rad]", "flipper travel [rad]"),
        *map(heading, further),
    ]
    methods = has_methods(result)
    if methods:
        headings.insert(1, "method")
    several = not methods and len({scene.controller for scene in result.scenes}) > 1
    found = Table(headings, title, words=["outcomes", _CAUSES])

    def cells(
        name: str,
        summary: Summary,
        because: Mapping[str, int] | None = None,
        method: str = "",
    ) -> list[str]:
        return [
            *(
                name,
                *((method,) if methods else ()),
                str(summary.episodes),
                interval_text(summary.success, 3),
            ),
            *(_passable_cells(summary) if passable else ()),
            _outcomes(summary),
            *((_numbers(because or {}),) if causes else ()),
            interval_text(summary.pitch_variation_100hz),
            *((interval_text(summary.static_bound),) if bound else ()),
            interval_text(summary.pitch_variation),
            *((_failed_text(summary),) if failed else ()),
            interval_text(summary.t_cost, 1),
            interval_text(summary.max_pitch),
            interval_text(summary.flipper_travel),
            *(interval_text(summary.further.get(m.plugin_name), m.digits) for m in further),
        ]

    last = None
    for name, scene in _named(result):
        if methods and last not in (None, name):
            found.end_section()
        last = name
        row = f"{name}, {scene.controller}" if several else name
        found.add(*cells(row, scene.summary, counts(scene.episodes), scene.method))
        for part, summary in scene.summary.parts.items():
            found.add(*cells(f"  {part}", summary), dim=True)
    return found


def has_methods(result: EvaluationResult) -> bool:
    """Return whether the result is that of several methods, or of a suite."""
    return any(scene.name.method for scene in result.scenes)


def comparisons(result: EvaluationResult) -> Iterator[Table]:
    """Yield a table of the paired differences to each baseline.

    A scene may lack baselines: after an interruption, or where one of them failed.
    """
    compared: dict[str, list[tuple[str, BaselineResult]]] = {}
    for name, scene in _named(result):
        for other in scene.baselines:
            compared.setdefault(other.controller, []).append((name, other))
    for baseline, found in compared.items():
        yield _comparison(baseline, found)


def _comparison(baseline: str, compared: list[tuple[str, BaselineResult]]) -> Table:
    further = shown(other.difference.further for _, other in compared)
    title = (
        f"difference to {baseline} on the same episodes; Δ of measures where both reached the "
        f"finish, {baseline}'s own where it did"
    )
    headings = [
        *("terrain", f"{baseline}: success", "Δ success", "won, lost", "p (Holm)", "pairs"),
        *(f"{baseline}: {HEADING}", f"Δ {HEADING}", f"Δ {PAPERS_HEADING}", "Δ t_cost [s]"),
        *(_difference_heading(measure) for measure in further),
    ]
    found = Table(headings, title)
    for name, other in compared:
        found.add(*_difference_cells(name, other.summary, other.difference, further))
        for label, part in other.difference.parts.items():
            cells = _difference_cells(f"  {label}", _part(other.summary, label), part, further)
            found.add(*cells, dim=True)
    return found


def _part(summary: Summary, label: str) -> Summary:
    """Return the summary of a kind of a mix; that of one kind, as after a stop, has no parts."""
    return summary.parts.get(label, summary)


def _whose(result: EvaluationResult, name: str, scene: SceneResult) -> str:
    """Return the name of a scene, after that of its policy if there are several."""
    several = len({one.method for one in result.scenes}) > 1
    return f"{scene.method} on {name}" if several else name


def group_tables(result: EvaluationResult) -> Iterator[Table]:
    """Yield a table of each scene's groups by each number (``eval --by``)."""
    for name, scene in _named(result):
        whose = _whose(result, name, scene)
        for by, groups in scene.by.items():
            if groups:
                yield group_table(whose, by, groups)


def search_lines(result: EvaluationResult) -> Iterator[str]:
    """Yield a line for each scene with a planning policy: means of numbers, counts of words."""
    for name, scene in _named(result):
        parts = []
        for key, value in scene.summary.search.items():
            if isinstance(value, Mapping):
                counts = (f"{word} {count}" for word, count in value.items())
                parts.append(f"{key}: {', '.join(counts)}")
            else:
                parts.append(f"{key} {value:.6g}")
        if parts:
            yield f"search on {_whose(result, name, scene)}, means: {'; '.join(parts)}"


def risk_lines(result: EvaluationResult) -> Iterator[str]:
    """Yield a line for each scene with a policy that tells its risk."""
    for name, scene in _named(result):
        if scene.summary.risk is not None:
            risk = risk_text(scene.summary.risk.to_dict())
            yield f"risk on {_whose(result, name, scene)}: {risk}"


def gap_cells(found: PairedSuccess) -> list[str]:
    """Return the difference of success, the episodes that only one crossed, and the p-value."""
    p = "<0.001" if found.p_holm < 0.001 else f"{found.p_holm:.3f}"
    return [interval_text(found, 3, sign="+"), f"{found.won}, {found.lost}", p]


def _named(result: EvaluationResult) -> Iterator[tuple[str, SceneResult]]:
    """Yield each scene and its name; those of several methods on equal episodes share it."""
    if has_methods(result):
        yield from zip(_shared_names(result), result.scenes, strict=True)
        return
    names = scene_names([(scene.terrain, scene.conditions) for scene in result.scenes])
    yield from zip(names, result.scenes, strict=True)


def _shared_names(result: EvaluationResult) -> list[str]:
    """Return the name of each scene: that within its suite, else its terrain and conditions."""
    keys = [(s.name.scene, s.terrain, s.conditions.label) for s in result.scenes]
    distinct = dict.fromkeys(keys)
    terrains = Counter((scene, terrain) for scene, terrain, _ in distinct)
    several = len({scene for scene, _, _ in distinct}) > 1
    names = {}
    for scene, terrain, label in distinct:
        whole = terrain if terrains[scene, terrain] == 1 else f"{terrain}, {label}"
        names[scene, terrain, label] = f"{whole}, {scene}" if several else whole
    return [names[key] for key in keys]


def _passable_cells(summary: Summary) -> list[str]:
    passable = summary.passable
    if passable is None:
        return [""] * len(_PASSABLE)
    return [str(passable.episodes), interval_text(passable.success, 3), str(passable.beyond)]


def _outcomes(summary: Summary) -> str:
    return _numbers(summary.outcomes.to_dict())


def _numbers(counted: Mapping[str, int]) -> str:
    return " ".join(f"{name} {count}" for name, count in counted.items() if count)


def _failed_text(summary: Summary) -> str:
    failed = summary.not_reached
    return interval_text(failed.pitch_variation_100hz if failed else None)


def _difference_heading(measure: type[Measure]) -> str:
    whole = "" if measure.reached_only else ", all pairs"
    better = f", {measure.better} is better" if measure.better else ""
    return f"Δ {heading(measure)}{whole}{better}"


def _difference_cells(
    name: str, other: Summary, difference: Differences, further: Sequence[type[Measure]]
) -> list[str]:
    variation = difference.pitch_variation_100hz
    return [
        name,
        interval_text(other.success, 3),
        *gap_cells(difference.success),
        str(variation.episodes if variation else 0),
        interval_text(other.pitch_variation_100hz),
        interval_text(variation),
        interval_text(difference.pitch_variation),
        interval_text(difference.t_cost, 1),
        *(interval_text(difference.further.get(m.plugin_name), m.digits) for m in further),
    ]
