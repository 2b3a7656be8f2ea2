"""Checks of a measure on recorded episodes of every outcome."""

from __future__ import annotations

import math
from itertools import pairwise
from numbers import Real

from flipperctl.api import Measure, Transition
from flipperctl.env.metrics import applies, heading, measures
from flipperctl.testing.check import require
from flipperctl.testing.recorded import transitions


def named(measure: Measure) -> None:
    """Check that its name is unique among columns, and that tables can show its unit."""
    require(measure.plugin_name in measures(), "is not among the measures of an episode")
    require(bool(measure.unit.strip()), f"has the heading {heading(type(measure))!r}; give a unit")


def finite(measure: Measure) -> None:
    """Check that the values of every episode and of its first decision alone are finite."""
    for episode in _episodes(measure):
        for part in (episode, episode[:1]):
            value = measure(part)
            require(
                isinstance(value, Real) and math.isfinite(value),
                f"for {len(part)} decisions ({part[-1].outcome or 'running'}) it returns "
                f"{value!r}; it must return a finite number",
            )


def pure(measure: Measure) -> None:
    """Check that the value depends only on the episode, and that the episode is unchanged."""
    for episode in _episodes(measure):
        before = [t.path.tobytes() for t in episode]
        first, again = measure(tuple(episode)), measure(episode)
        require(first == again, f"it returns {first!r} and, called again, {again!r}")
        unchanged = [t.path.tobytes() for t in episode] == before
        require(unchanged, "it changes the poses of the episode")


def _episodes(measure: Measure) -> list[list[Transition]]:
    """Return the recorded transitions that have the measure, episode by episode."""
    recorded = transitions()
    ends = [0, *(at + 1 for at, t in enumerate(recorded) if t.outcome is not None)]
    found = [list(recorded[first:last]) for first, last in pairwise(ends)]
    return [episode for episode in found if applies(measure, episode)]
