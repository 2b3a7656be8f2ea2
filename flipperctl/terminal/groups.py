"""The tables of ``flipperctl eval --by``: results by what was drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flipperctl.evaluation.results import BaselineResult, Group
from flipperctl.evaluation.tables import interval_text
from flipperctl.terminal.pitch_variation import HEADING
from flipperctl.terminal.tables import Table

BOUND = "static bound [rad]"
"""Heading of the static lower bound of θ̂_R."""


def group_table(scene: str, name: str, groups: Sequence[Group]) -> Table:
    """Return a row for each group: success, θ̂_R and the paired differences to each baseline."""
    names = list(groups[0].ranges)
    bound = any(group.summary.static_bound for group in groups)
    against = list(dict.fromkeys(b.controller for group in groups for b in group.baselines))
    headings = [*names, "episodes", "success", HEADING, *((BOUND,) if bound else ())]
    for label in against:
        headings += [f"{label}: {HEADING}", f"Δ {HEADING} to {label}", f"Δ success to {label}"]
    found = Table(headings, f"{scene} by {name.replace('+', ' and ')}")
    for group in groups:
        found.add(*_cells(group, bound, against))
    return found


def _cells(group: Group, bound: bool, against: Sequence[str]) -> Iterator[str]:
    for low, high in group.ranges.values():
        yield f"{low:.4g}" if low == high else f"{low:.3g} to {high:.3g}"
    summary = group.summary
    yield str(summary.episodes)
    yield interval_text(summary.success, 3)
    yield interval_text(summary.pitch_variation_100hz)
    if bound:
        yield interval_text(summary.static_bound)
    others = {b.controller: b for b in group.baselines}
    for label in against:
        yield from _difference_cells(others.get(label))


def _difference_cells(other: BaselineResult | None) -> tuple[str, str, str]:
    if other is None:  # an interrupted baseline played none of these episodes
        return "–", "–", "–"
    return (
        interval_text(other.summary.pitch_variation_100hz),
        interval_text(other.difference.pitch_variation_100hz, sign="+"),
        interval_text(other.difference.success, 3, sign="+"),
    )
