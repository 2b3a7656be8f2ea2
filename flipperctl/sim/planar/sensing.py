"""Sensing: what a robot with a terrain map and an inertial unit knows of its surroundings.

In: the true profile and state. Out: terrain points in frame L and the mean height of each bin.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray, Profile
from flipperctl.config import PerceptionSettings


class TerrainSensor:
    """Samples the profile once, then looks up what lies around the robot."""

    def __init__(self, profile: Profile, settings: PerceptionSettings, margin: float) -> None:
        """``margin``: level ground that may come into view on either side [m]."""
        self.settings = settings
        self._cloud = profile.sample(1 / settings.density, margin)
        self._x = np.ascontiguousarray(self._cloud[:, 0])

    def points(self, position: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Sensed terrain points in frame L, x never decreasing, (P, 2) [m]."""
        s = self.settings
        low, high = np.searchsorted(
            self._x, (position[0] - s.reach, position[0] + min(s.reach, s.horizon))
        )
        points = self._cloud[low:high] - position
        if s.bias:
            points[:, 1] += s.bias
        if s.noise > 0:
            points[:, 1] += rng.normal(0.0, s.noise, len(points))
        if s.dropout > 0:
            points = points[rng.random(len(points)) >= s.dropout]
        return points

    def heights(self, points: FloatArray) -> FloatArray:
        """Mean height of the points of each bin, (N,) in frame L [m] (paper Eq. 1).

        A bin without points takes its height from its neighbours, linearly; without any point
        at all, every height is 0.
        """
        s = self.settings
        index = ((points[:, 0] + s.reach) / s.bin_width).astype(np.intp)
        index = np.minimum(index, s.bins - 1)
        count = np.bincount(index, minlength=s.bins)
        total = np.bincount(index, weights=points[:, 1], minlength=s.bins)
        seen = count > 0
        if seen.all():
            return np.asarray(total / count)
        if not seen.any():
            return np.zeros(s.bins)
        where = np.flatnonzero(seen)
        return np.interp(np.arange(s.bins), where, total[where] / count[where])
