"""What a policy loses from engine to engine on the same episodes (``eval … sim=planar,mujoco``).

In: the result of an evaluation with the steps of ``evaluation.engines``. Out: a document of what is
lost from one step to the next, paired by seed, tables, and a line for each failure in the last one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from flipperctl.evaluation.engines import comparisons as steps_of
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.rows import CAUSE, END, reached
from flipperctl.text.messages import percent
from flipperctl.text.show import NONE, Column, Table
from flipperctl.views.summary import (
    Document,
    correct_all,
    difference,
    gap_text,
    summary,
)


def document(result: Result) -> list[Document]:
    """Return what each policy loses from engine to engine on each terrain, as plain data."""
    comparisons = [_document(group) for group in steps_of(result)]
    sensed = [comparison["sensed"]["gap"] for comparison in comparisons if "sensed" in comparison]
    correct_all([*(comparison["gap"] for comparison in comparisons), *sensed])
    for comparison in comparisons:
        comparison["success_gap"] = comparison["gap"]["success"]
    return comparisons


def _document(group: Sequence[Played]) -> Document:
    first, second, *rest = group
    entry, last = second.entry, group[-1]
    # Failures of the last step, beside how the default engine ended the same episodes
    failed = [
        {
            **{name: row[name] for name in ("episode", "seed", "terrain", "outcome")},
            "cause": row[CAUSE],
            "default_outcome": before["outcome"],
            "time": row["t_cost"],
            **{name: row[column] for name, column in END.items()},
        }
        for row, before in last.episodes.failed.paired(first.episodes)
    ]
    counts = Counter(failure["cause"] for failure in failed).most_common()
    comparison: Document = {
        "terrain": entry.terrain,
        "controller": entry.label,
        "engines": [first.entry.sim, entry.sim],
        "seed": entry.config.eval.seed,
        "conditions": last.entry.conditions.to_dict(),
        first.entry.sim: summary(entry.terrain, first.episodes),
        entry.sim: summary(entry.terrain, second.episodes),
        "kept": _kept(first, second),
        "gap": difference(second.episodes, first.episodes),
        "causes": dict(counts),
        "failures": failed,
    }
    # A sensor that maps the ground makes a third step, in the same engine.
    for sensed in rest:
        comparison["sensed"] = {
            "sensor": sensed.entry.config.perception.plugin_name,
            "summary": summary(entry.terrain, sensed.episodes),
            "gap": difference(sensed.episodes, second.episodes),
            "kept": _kept(second, sensed),
        }
    return comparison


def _kept(first: Played, then: Played) -> float | None:
    """Return the fraction of the episodes reached at first that are reached then."""
    pairs = first.episodes.paired(then.episodes)
    crossed = [reached(after) for before, after in pairs if reached(before)]
    return sum(crossed) / len(crossed) if crossed else None


_COLUMNS = (
    Column("terrain", "scene", named=True),
    Column("policy", "policy", named=True),
    Column("step", "step", named=True),
    Column("success", "Δ success (p, Holm of {of})"),
    Column("variation", "Δ pitch variation [rad]", sign="+"),
    Column("kept", "still crossed"),
    Column("causes", "failures by cause", named=True),
)


def tables(comparisons: Sequence[Mapping[str, Any]]) -> Iterator[Table]:
    """Yield the table of losses; a row for each step of each policy on each terrain."""
    rows = []
    called = short_names([comparison["controller"] for comparison in comparisons])
    for comparison in comparisons:
        causes = ", ".join(f"{cause} {count}" for cause, count in comparison["causes"].items())
        # The engine first, and then its sensing, if that is compared too
        steps = {" → ".join(comparison["engines"]): comparison}
        if "sensed" in comparison:
            steps[comparison["sensed"]["sensor"]] = comparison["sensed"]
        for at, (step, lost) in enumerate(steps.items(), 1):
            fraction = lost["kept"]
            rows.append(
                {
                    "terrain": comparison["terrain"],
                    "policy": called[comparison["controller"]],
                    "step": step,
                    "causes": causes if at == len(steps) else "",
                    "success": gap_text(lost["gap"]["success"]),
                    "variation": lost["gap"]["pitch_variation_100hz"],
                    "kept": NONE if fraction is None else percent(fraction),
                }
            )
    if rows:
        # Their p-values are corrected together, those of each part of the episodes included.
        gaps = [step["gap"] for c in comparisons for step in (c, c.get("sensed")) if step]
        of = sum(1 + len(gap.get("parts", ())) for gap in gaps)
        columns = [replace(column, heading=column.heading.format(of=of)) for column in _COLUMNS]
        yield Table(columns, rows, "From engine to engine, same episodes")


def failure_lines(comparisons: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line for each failure in the last step."""
    for row in comparisons:
        for f in row["failures"]:
            yield (
                f"{row['terrain']}, episode {f['episode']}: {f['cause']} ({f['outcome']} after "
                f"{f['time']:.1f} s at x {f['x']:.2f} m, pitch {f['pitch']:.2f}, roll "
                f"{f['roll']:.2f}, yaw {f['yaw']:.2f} rad, {f['side']:.2f} m aside; "
                f"{f['default_outcome']} in {row['engines'][0]})"
            )
