"""The measures and reward sums of one episode, accumulated while it runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flipperctl.api import Transition
from flipperctl.env.measures.measure import Measure


class EpisodeMetrics:
    """Accumulates the measures and the weighted reward terms of one episode."""

    def __init__(self, measures: Sequence[type[Measure]]) -> None:
        self._measures = [measure() for measure in measures]
        self._parts: dict[str, float] = {}

    def add(self, t: Transition, parts: Mapping[str, float]) -> None:
        """Add one decision with the weighted values of its reward terms."""
        for measure in self._measures:
            measure.add(t)
        for name, value in parts.items():
            self._parts[name] = self._parts.get(name, 0.0) + value

    def summary(self) -> dict[str, float]:
        """Return numbers by name: each measure, the return, and each reward term's part of it."""
        return {
            **{measure.name: measure.value for measure in self._measures},
            "return": sum(self._parts.values()),
            **{f"reward_{name}": value for name, value in self._parts.items()},
        }
