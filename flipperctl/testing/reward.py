"""Checks of a reward term on recorded episodes of every outcome."""

from __future__ import annotations

import math

from flipperctl.api import RewardTerm, Transition
from flipperctl.testing.check import require
from flipperctl.testing.recorded import transitions

_ROUNDING = 1e-9


def finite(reward: RewardTerm) -> None:
    """Check that the reward of every transition is a finite float."""
    for t in transitions():
        value = reward(t)
        require(
            isinstance(value, float) and math.isfinite(value),
            f"{_at(t)} it returns {value!r}; it must return a finite float",
        )


def bounded(reward: RewardTerm) -> None:
    """Check that every reward lies within ``bounds``."""
    low, high = reward.bounds
    require(low <= high, f"bounds are {reward.bounds}; the lower one must come first")
    for t in transitions():
        value = reward(t)
        require(
            low - _ROUNDING <= value <= high + _ROUNDING,
            f"{_at(t)} it returns {value:g}; its bounds say {low:g} to {high:g}",
        )


def pure(reward: RewardTerm) -> None:
    """Check that the reward depends only on the transition and does not change it."""
    pitches = [t.pitches.tobytes() for t in transitions()]
    first = [reward(t) for t in transitions()]
    again = [reward(t) for t in reversed(transitions())][::-1]
    for t, one, other, before in zip(transitions(), first, again, pitches, strict=True):
        require(
            one == other,
            f"{_at(t)} it returns {one!r} and, called again, {other!r}; "
            "it may depend only on the transition",
        )
        require(t.pitches.tobytes() == before, f"{_at(t)} it changes the transition's pitches")


def _at(t: Transition) -> str:
    return f"at {t.after.time:.1f} s of an episode ({t.outcome or 'running'})"
