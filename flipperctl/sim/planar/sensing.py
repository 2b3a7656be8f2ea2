"""``perception=planar``: terrain points in the side plane, with noise and a horizon.

In: the true profile and state. Out: terrain points in frame L and the mean height of each bin.
Nothing is occluded: points hidden by an edge or inside a trench are sensed from everywhere within
the horizon.
"""

from __future__ import annotations

import numpy as np
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

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense the ground around the robot, then its posture."""
        s = self.settings
        points = self.points(state.position, rng)
        angles = np.array(
            [state.front + s.flipper_bias, state.rear + s.flipper_bias, state.pitch + s.pitch_bias]
        )
        if s.angle_noise > 0:
            angles = angles + rng.normal(0.0, s.angle_noise, 3)
        front, rear, pitch = map(float, angles)
        ground = SensedGround(points, self.heights(points))
        return ground, SensedAngles(front, rear, pitch)

    def points(self, position: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the sensed terrain points in frame L, x never decreasing, (P, 2) [m]."""
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
        """Return the mean height of the points of each bin, (N,) in frame L [m] (paper Eq. 1).

        The height of a bin without points is interpolated linearly between its neighbours; without
        any points, every height is 0.
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
