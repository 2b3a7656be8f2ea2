"""Checks of a measure on recorded episodes of every outcome."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from numbers import Real

import numpy as np

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
    if measure.mapped_only:
        found = [[_mapped(t) for t in episode] for episode in found]
    return [episode for episode in found if applies(measure, episode)]


def _mapped(t: Transition) -> Transition:
    """Return the transition as a sensor perceives it that maps the ground and has odometry."""
    assert t.perception is not None  # as in every episode
    seen = np.arange(t.perception.layout.bins) % 3 > 0
    place = 1.02 * t.before.position
    return replace(t, perception=replace(t.perception, seen=seen, position=place))
