"""Checks of a reward term on recorded episodes of every outcome."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from flipperctl.api import RewardTerm, Transition, Transitions
from flipperctl.testing.check import require
from flipperctl.testing.recorded import transitions, transitions_in_arrays

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
    """Check that the reward depends only on the transition."""
    first = [reward(t) for t in transitions()]
    again = [reward(t) for t in reversed(transitions())][::-1]
    for t, one, other in zip(transitions(), first, again, strict=True):
        require(
            one == other,
            f"{_at(t)} it returns {one!r} and, called again, {other!r}; "
            "it may depend only on the transition",
        )


def same_in_arrays(reward: RewardTerm) -> None:
    """Check that ``array`` returns what ``__call__`` returns, and does not change its input."""
    for ts in transitions_in_arrays():
        before = [array.tobytes() for array in _arrays(ts)]
        found: object = reward.array(ts)
        require(
            isinstance(found, np.ndarray)
            and found.dtype.kind in "fiu"
            and found.shape == (len(ts),),
            f"array of {len(ts)} transitions returns {_described(found)}; an array of floats of "
            f"shape ({len(ts)},) is allowed",
        )
        require(
            [array.tobytes() for array in _arrays(ts)] == before,
            "array changes the transitions that it is given",
        )
        for t, value in zip(ts, np.asarray(found).tolist(), strict=True):
            expected = reward(t)
            require(
                abs(value - expected) <= _ROUNDING * max(1.0, abs(expected)),
                f"{_at(t)} array returns {value!r} and __call__ {expected!r}; "
                f"they may differ by {_ROUNDING:g}, relative to values above 1",
            )


def _arrays(ts: Transitions) -> Iterator[np.ndarray]:
    """Yield each array of the transitions and of their states."""
    for part in (ts, ts.before, ts.after):
        values = (getattr(part, field.name) for field in fields(part))
        yield from (value for value in values if isinstance(value, np.ndarray))


def _described(value: object) -> str:
    shape = getattr(value, "shape", None)
    kind = getattr(value, "dtype", "")
    return type(value).__name__ if shape is None else f"one of {kind} and shape {shape}"


def _at(t: Transition) -> str:
    return f"at {t.after.time:.1f} s of an episode ({t.outcome or 'running'})"
