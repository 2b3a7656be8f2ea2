"""Errors of a map that a robot builds as it drives, as a cheap model for training.

In: the sampled ground, the robot's motion. Out: errors of the heights and of the places of its
points. Heights are wrong by a stationary process along x, which stays on the map. Odometry moves
the robot on its map by a random walk along the way, so ground that was seen earlier is displaced by
as much as odometry has erred since; what is ahead is seen anew at each decision. Each new scan also
displaces all of the map a bit, by an error of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray

NEAREST = 0.3
"""Ground farther ahead of the chassis centre than this is seen anew at each decision [m]."""
LARGEST = 0.3
"""Largest displacement [m]."""


@dataclass(frozen=True)
class MapErrorSize:
    """Parameters of the model."""

    height: float
    """Standard deviation of the heights' error [m]."""
    length: float
    """Distance along x over which the heights' error loses its correlation [m]."""
    drift: float
    """Standard deviation of the odometry's error over 1 m of the way [m]."""
    jitter: float = 0.0
    """Standard deviation of a displacement that is drawn anew at each decision [m]."""


class MapErrors:
    """The errors of the map of one episode."""

    def __init__(self, x: FloatArray, size: MapErrorSize) -> None:
        """``x``: world x of the ground's points, never decreasing, (P,) [m]."""
        self._x, self._size = x, size
        self._height: FloatArray | None = None  # (P,) [m]; sampled at the first decision
        self._seen_at = np.zeros(len(x))  # odometry's error when each point was seen last [m]
        self._error = 0.0  # of odometry now [m]
        self._jitter = 0.0  # displacement of the whole ground now [m]
        self._at: float | None = None  # the robot's x at the last decision [m]

    def advance(self, x: float, rng: np.random.Generator) -> None:
        """Move the robot to ``x`` [m]; call it once for each decision."""
        if self._height is None:
            self._height = self._size.height * correlated(self._x, self._size.length, rng)
        moved = 0.0 if self._at is None else abs(x - self._at)
        self._error += self._size.drift * math.sqrt(moved) * float(rng.standard_normal())
        if self._size.jitter:  # without it, no other random number changes
            self._jitter = self._size.jitter * float(rng.standard_normal())
        self._at = x
        self._seen_at[np.searchsorted(self._x, x + NEAREST) :] = self._error

    def apply(self, points: FloatArray, index: Any) -> None:
        """Add the errors to ``points`` (P, 2), in place; x stays in order.

        ``index``: which points of the sampled ground these are, a slice or numbers.
        """
        if self._height is None:
            return
        points[:, 1] += self._height[index]
        displaced = self._seen_at[index] - self._error + self._jitter
        points[:, 0] += np.clip(displaced, -LARGEST, LARGEST)
        np.maximum.accumulate(points[:, 0], out=points[:, 0])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later decisions do not change."""
        return self._height, self._seen_at.copy(), self._error, self._at, self._jitter

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._height, seen_at, self._error, self._at, self._jitter = saved
        self._seen_at[:] = seen_at


def correlated(x: FloatArray, length: float, rng: np.random.Generator) -> FloatArray:
    """Return values of a stationary process of unit variance at ``x``, (P,).

    It is Ornstein and Uhlenbeck's: the correlation of two places is exp(-distance / length).
    """
    stays = np.exp(-np.diff(x) / length)
    steps = rng.standard_normal(len(x))
    steps[1:] *= np.sqrt(1 - stays**2)
    found = np.empty(len(x))
    value = 0.0
    for i, (keep, step) in enumerate(zip([0.0, *stays.tolist()], steps.tolist(), strict=True)):
        value = keep * value + step
        found[i] = value
    return found
