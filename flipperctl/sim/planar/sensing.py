"""``perception=planar``: terrain points in the side plane, with noise and a horizon.

In: the true profile and state. Out: terrain points in frame L and the mean height of each bin.
Nothing is occluded: points hidden by an edge or inside a trench are sensed from everywhere within
the horizon.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numba import njit
from pydantic import Field

from flipperctl.api import (
    FloatArray,
    Profile,
    RobotState,
    SensedAngles,
    SensedGround,
    Sensor,
    sensor,
)
from flipperctl.sim.jit import cached


@sensor("planar")
class PlanarSensor(Sensor):
    """Senses points along the outline of the ground and averages their heights in bins."""

    density: float = Field(
        50.0, gt=5, le=1000, description="points per metre of outline; not given in the paper [1/m]"
    )
    noise: float = Field(
        0.0, ge=0, le=0.2, description="standard deviation of a point's height [m]"
    )
    dropout: float = Field(0.0, ge=0, lt=1, description="fraction of points missing [-]")
    bias: float = Field(
        0.0, ge=-0.2, le=0.2, description="error of all points' height, constant [m]"
    )
    horizon: float = Field(
        10.0, gt=0, le=10, description="points farther ahead are not seen yet [m]"
    )
    angle_noise: float = Field(
        0.0, ge=0, le=0.2, description="standard deviation of each measured angle [rad]"
    )
    pitch_bias: float = Field(
        0.0, ge=-0.2, le=0.2, description="error of the measured pitch, constant [rad]"
    )
    flipper_bias: float = Field(
        0.0, ge=-0.2, le=0.2, description="error of both measured flipper angles, constant [rad]"
    )

    def over(self, profile: Profile, margin: float) -> TerrainSensor:
        """Return a sensor that samples the profile once for the whole episode."""
        return TerrainSensor(profile, self, margin)


class TerrainSensor:
    """Samples the profile once, then returns the points around the robot."""

    def __init__(self, profile: Profile, settings: PlanarSensor, margin: float) -> None:
        """Sample ``profile`` with ``margin`` [m] of level ground on either side."""
        self.settings = settings
        self._cloud = profile.sample(1 / settings.density, margin)
        self._x = np.ascontiguousarray(self._cloud[:, 0])
        self._reach = settings.reach

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense the ground around the robot, then its posture."""
        s = self.settings
        points = self.points(state.position, rng)
        front, rear = state.front + s.flipper_bias, state.rear + s.flipper_bias
        pitch = state.pitch + s.pitch_bias
        if s.angle_noise > 0:
            front, rear, pitch = (front, rear, pitch) + rng.normal(0.0, s.angle_noise, 3)
        ground = SensedGround(points, self.heights(points))
        return ground, SensedAngles(float(front), float(rear), float(pitch))

    def points(self, position: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the sensed terrain points in frame L, x never decreasing, (P, 2) [m]."""
        s = self.settings
        x = float(position[0])
        low = bisect_left(self._x.data, x - self._reach)
        high = bisect_left(self._x.data, x + min(self._reach, s.horizon))
        points = self._cloud[low:high] - position
        if s.bias:
            points[:, 1] += s.bias
        if s.noise > 0:
            points[:, 1] += rng.normal(0.0, s.noise, len(points))
        if s.dropout > 0:
            points = points[rng.random(len(points)) >= s.dropout]
        return points

    def heights(self, points: FloatArray) -> FloatArray:
        """Return the mean height of the points of each bin, (N,) in frame L [m] (paper Eq. 1).

        The height of a bin without points is interpolated linearly between its neighbours; without
        any points, every height is 0.
        """
        s = self.settings
        total, count = np.zeros(s.bins), np.zeros(s.bins)
        seen = _sum_bins(points, self._reach, s.bin_width, total, count)
        if seen == s.bins:
            return total / count
        if not seen:
            return total
        where = np.flatnonzero(count)
        return np.interp(np.arange(s.bins), where, total[where] / count[where])


@cached(njit)
def _sum_bins(
    points: FloatArray, reach: float, width: float, total: FloatArray, count: FloatArray
) -> int:
    """Sum up the heights of each bin's points and count them; return the number of bins with any.

    ``points`` are (P, 2) in frame L within ``reach`` [m]; ``total`` and ``count`` are (N,) zeros.
    """
    seen = 0
    for i in range(len(points)):
        index = min(int((points[i, 0] + reach) / width), len(total) - 1)
        if count[index] == 0:
            seen += 1
        total[index] += points[i, 1]
        count[index] += 1
    return seen
