"""``perception=planar``: terrain points in the side plane, with noise and a horizon.

In: the true profile and state. Out: terrain points in frame L and the mean height of each bin.
Without ``occlusion``, all points within the horizon are sensed, even hidden ones behind an edge or
in a trench. With it, ``rays.SeenGround`` determines which points a sensor on a mast has seen.

With ``sides``, rays from above find the ground below the tracks of a world in 3-D, as ``sides``
says. What hides it, and the errors of a map, are those of the side plane at the same x.

``MapErrors`` is a cheap model of a map that a robot builds as it drives. Heights are wrong by a
stationary process along x, which stays on the map. Odometry moves the robot on its map by a random
walk along the way. Ground that was seen earlier is displaced by as much as odometry has erred
since; ground ahead is seen anew at each decision. Each new scan also displaces all of the map a
bit, by an error of its own.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from flipperctl.api import (
    FloatArray,
    GroundSensor,
    Mounting,
    Profile,
    RayWorld,
    RobotState,
    RollingWorld,
    SensedAngles,
    SensedGround,
    Sensor,
    sensor,
)
from flipperctl.core.building import built
from flipperctl.core.lidar.body import attitude
from flipperctl.core.lidar.ground import OFF_LINE, lateral_slope, side_of
from flipperctl.core.lidar.outline import columns, points_along, polyline
from flipperctl.core.observation import HALF_WIDTH, SIDES, bin_heights
from flipperctl.core.targets import angles_of, by_joint


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
        10.0, gt=0, le=10, description="range ahead; points beyond it are not seen yet [m]"
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

    map_error: float = Field(
        0.0,
        ge=0,
        le=0.1,
        description="standard deviation of an error of the ground's heights that stays at its "
        "place during the episode, as on a map; 0.004 is like perception=lidar [m]",
    )
    map_length: float = Field(
        2.0,
        gt=0.01,
        le=10,
        description="distance over which map_error loses its correlation, as fitted to "
        "perception=lidar, whose bias of the distances reaches far [m]",
    )
    map_drift: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="standard deviation of the error of odometry over 1 m of the way, by which "
        "ground that was seen earlier, below and behind the robot, is displaced; 0.08, with a "
        "map_jitter of 0.02, is like perception=lidar perception.pose=matched [m]",
    )
    map_jitter: float = Field(
        0.0,
        ge=0,
        le=0.1,
        description="standard deviation of a displacement of all the ground along x that is drawn "
        "anew at each decision, as new scans change a map [m]",
    )
    occlusion: bool = Field(
        False,
        description="points hidden from the mount are missing until they are seen; unseen ground "
        "is filled linearly between its neighbours, and level past the last one [-]",
    )
    mount_x: float = Field(
        0.25,
        ge=-2,
        le=2,
        description="distance of the ranging sensor ahead of the chassis centre, along the "
        "chassis: just behind the front flippers' hinge; not given in the paper [m]",
    )
    mount_z: float = Field(
        0.4,
        gt=0,
        le=2,
        description="height of the ranging sensor above the chassis centre: a short mast, 0.5 m "
        "above level ground; not given in the paper [m]",
    )
    body_length: float = Field(
        0.76,
        ge=0,
        le=3,
        description="length of the chassis, which hides the ground below it from the mount; the "
        "flippers beside it hide nothing [m]",
    )

    @property
    def without_effect(self) -> frozenset[str]:
        """Settings that change nothing, so that hashes without a map's errors stay the same."""
        unused = frozenset() if self.map_jitter else frozenset({"map_jitter"})
        if self.map_error or self.map_drift or self.map_jitter:
            return unused
        return unused | {"map_error", "map_length", "map_drift"}

    def over(self, profile: Profile, margin: float) -> TerrainSensor:
        """Return a sensor that samples the profile once for the whole episode."""
        return TerrainSensor(profile, self, margin)

    def mounted(self, mounting: Mounting) -> GroundSensor:
        """Return a sensor of the profile, and with ``sides`` of the ground beside it in 3-D."""
        if not (self.sides and isinstance(mounting.rays, RollingWorld)):
            return super().mounted(mounting)
        return TerrainSensor(mounting.profile, self, mounting.margin, mounting.rays)


class TerrainSensor:
    """Samples the profile once, then returns the points around the robot."""

    def __init__(
        self,
        profile: Profile,
        settings: PlanarSensor,
        margin: float,
        beside: RayWorld | None = None,
    ) -> None:
        """Sample ``profile`` with ``margin`` [m] of level ground before and past it.

        ``beside``: the world in which both sides are sensed; None: they are as the profile is.
        """
        from flipperctl.sim.planar import rays  # numba takes a third of a second to import

        s = self.settings = settings
        self._rays, self._spacing, self._reach = rays, 1 / s.density, s.reach
        self._cloud = profile.sample(self._spacing, margin)
        self._x = np.ascontiguousarray(self._cloud[:, 0])
        self._beside = beside
        self._map_errors: MapErrors | None = None
        if s.map_error or s.map_drift or s.map_jitter:
            size = MapErrorSize(s.map_error, s.map_length, s.map_drift, s.map_jitter)
            self._map_errors = MapErrors(self._x, size)
        self._seen_ground: rays.SeenGround | None = None
        if s.occlusion:
            mast = rays.Mast((s.mount_x, s.mount_z), s.body_length, s.horizon)
            vertices = profile.extended(margin, margin)
            self._seen_ground = rays.SeenGround(self._cloud, self._spacing, vertices, mast)

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense the ground around the robot, then its posture."""
        s = self.settings
        # The map first: what a line of sight reaches from here, and how far odometry errs by now.
        if self._seen_ground is not None:
            self._seen_ground.scan(state)
        if self._map_errors is not None:
            self._map_errors.advance(float(state.position[0]), rng)
        points, filled = self._sensed(state.position, rng)
        # The angles, with their constant and their white errors
        flippers = [angle + s.flipper_bias for angle in angles_of(state)]
        pitch = state.pitch + s.pitch_bias
        if s.angle_noise > 0:
            *noise, last = rng.normal(0.0, s.angle_noise, len(flippers) + 1).tolist()
            flippers = [angle + error for angle, error in zip(flippers, noise, strict=True)]
            pitch += last
        heights = bin_heights(
            points, s.bins, s.bin_width, highest=s.highest, add_heights=self._rays.add_heights
        )
        roll = state.roll
        if s.sides and s.angle_noise > 0:  # last, so that the other numbers stay the same
            roll += rng.normal(0.0, s.angle_noise)
        if s.sides:
            heights = self._with_sides(heights, state, rng)
        posture = by_joint(flippers)
        angles = built(SensedAngles, **posture, pitch=float(pitch), roll=float(roll))
        # The robot is where its odometry places it.
        odometry = state.position.copy()
        if self._map_errors is not None:
            odometry[0] += self._map_errors.error
        ground = built(
            SensedGround, points=points, heights=heights, filled=filled, position=odometry
        )
        return ground, angles

    def _with_sides(
        self, heights: FloatArray, state: RobotState, rng: np.random.Generator
    ) -> FloatArray:
        """Return the heights, then those below the left and below the right tracks [m]."""
        s = self.settings
        if self._beside is None:
            return np.tile(heights, 3)
        points = ground_beside(self._beside, state, self._reach)
        index = np.searchsorted(self._x, points[:, 0] + state.position[0])
        index = np.minimum(index, len(self._x) - 1)
        # What the side plane has at the same x: errors of the map, hidden ground, lost points
        if self._map_errors is not None:
            self._map_errors.apply(flat := points[:, [0, 2]], index)
            points[:, [0, 2]] = flat
        points[:, 2] += s.bias
        if s.noise > 0:
            points[:, 2] += rng.normal(0.0, s.noise, len(points))
        seen = points[:, 0] < min(self._reach, s.horizon)
        if self._seen_ground is not None:
            seen &= self._seen_ground.seen[index]
        if s.dropout > 0:
            seen &= rng.random(len(points)) >= s.dropout
        points = points[seen]
        return np.concatenate([heights, *self._of_sides(points)])

    def _of_sides(self, points: FloatArray) -> Iterator[FloatArray]:
        """Yield the heights of each side by points (P, 3) in frame L, as a LiDAR's map does."""
        s = self.settings
        slope = lateral_slope(points, CELL, OFF_LINE + s.noise)
        for sign in SIDES.values():
            line = polyline(columns(side_of(points, sign, slope), CELL, 1), s.noise)
            level = np.zeros(len(line), np.bool_)
            limits = -self._reach, self._reach
            below, _ = points_along(line, level, self._spacing, math.inf, limits)
            yield bin_heights(
                below, s.bins, s.bin_width, highest=s.highest, add_heights=self._rays.add_heights
            )

    def save(self) -> tuple[Any, Any]:
        """Return a snapshot of the seen points and of the map's errors."""
        ground, errors = self._seen_ground, self._map_errors
        return ground and ground.seen.copy(), errors and errors.save()

    def load(self, saved: tuple[Any, Any]) -> None:
        """Restore a snapshot."""
        seen, errors = saved
        if self._seen_ground is not None:
            self._seen_ground.seen[:] = seen
        if self._map_errors is not None:
            self._map_errors.load(errors)

    def _sensed(
        self, position: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, NDArray[np.bool_] | None]:
        """Return the points in frame L, (P, 2) [m], and with occlusion which of them are filled."""
        s, x, ground, errors = (
            self.settings,
            float(position[0]),
            self._seen_ground,
            self._map_errors,
        )
        # Displaced points may come from outside the range, so that a wider one is searched.
        near, beyond = min(self._reach, s.horizon), LARGEST if errors else 0.0
        low = bisect_left(self._x.data, x - self._reach - beyond)
        high = bisect_left(self._x.data, x + near + beyond)
        index: Any = slice(low, high)
        # With occlusion, a seen neighbour on either side is needed to fill the gaps at the ends.
        if ground is not None:
            index = self._rays.known_points(ground.seen, low, high)
        # Errors of the map, the constant error of the sensor, its noise
        points = self._cloud[index] - position
        if errors is not None:
            errors.apply(points, index)
        if s.bias:
            points[:, 1] += s.bias
        if s.noise > 0:
            points[:, 1] += rng.normal(0.0, s.noise, len(points))
        # Displaced points may have left the range.
        inside = (points[:, 0] >= -self._reach) & (points[:, 0] < near) if errors else None
        if ground is None:
            points = points if inside is None else points[inside]
            return (points[rng.random(len(points)) >= s.dropout] if s.dropout > 0 else points), None
        # Hidden and lost points are filled between their neighbours.
        offered = (index >= low) & (index < high)
        if inside is not None:
            offered &= inside
        if s.dropout > 0:
            offered &= rng.random(len(points)) >= s.dropout
        limits = -self._reach, near
        sensed = self._rays.fill_gaps(points, index, offered, self._spacing, limits)
        return sensed[0], sensed[1]


CELL = 0.025
"""Length of the columns of ground below the tracks, as in a LiDAR's map [m]."""
_LANES = 4  # points of a column on each side [-]
_ABOVE = 50.0  # height from which rays find the ground below the tracks, nearly upright [m]


def ground_beside(world: RayWorld, state: RobotState, reach: float) -> FloatArray:
    """Return points of the ground below both sides' tracks in frame L, by x, (P, 3) [m].

    ``reach``: distance ahead and behind [m].
    """
    # A grid whose lanes are displaced, so that x is spaced evenly
    count = math.ceil(2 * reach / CELL) * _LANES
    x = (np.arange(count) + 0.5) * CELL / _LANES - reach
    lane = (np.arange(count) % _LANES + 0.5) * HALF_WIDTH / _LANES
    grid = np.stack([np.tile(x, 2), np.concatenate([lane, -lane]), np.full(2 * count, -_ABOVE)], 1)
    ahead = grid / np.linalg.norm(grid, axis=1, keepdims=True)  # from a point above the robot
    # From frame L, which is level, to world, where gravity may be tilted
    turn = np.eye(3) if state.orientation is None else state.orientation
    turn = turn @ attitude(state.roll, state.pitch, 0.0).T
    centre = np.array([state.position[0], state.side, state.position[1]])
    origin = centre + _ABOVE * turn[:, 2]
    far = world.cast_rays(origin, ahead @ turn.T, 2 * _ABOVE)
    hit = np.isfinite(far)
    points = ahead[hit] * far[hit, None] + (0.0, 0.0, _ABOVE)
    return np.asarray(points[np.argsort(points[:, 0], kind="stable")])


NEAREST = 0.3
"""Ground farther ahead of the chassis centre than this is seen anew at each decision [m]."""
LARGEST = 0.3
"""Largest displacement [m]."""


@dataclass(frozen=True)
class MapErrorSize:
    """Parameters of the model."""

    height: float  # standard deviation of the heights' error [m]
    length: float  # distance along x over which the heights' error loses its correlation [m]
    drift: float  # standard deviation of the odometry's error over 1 m of the way [m]
    jitter: float = 0.0
    """Standard deviation of a displacement that is drawn anew at each decision [m]."""


class MapErrors:
    """The errors of the map of one episode."""

    def __init__(self, x: FloatArray, size: MapErrorSize) -> None:
        """``x``: world x of the ground's points, never decreasing, (P,) [m]."""
        self._x, self._size = x, size
        self._height: FloatArray | None = None  # (P,) [m]; sampled at the first decision
        self._seen_at = np.zeros(len(x))  # odometry's error when each point was seen last [m]
        self.error = 0.0
        """Error of odometry now [m]."""
        self._jitter = 0.0  # displacement of the whole ground now [m]
        self._at: float | None = None  # the robot's x at the last decision [m]

    def advance(self, x: float, rng: np.random.Generator) -> None:
        """Move the robot to ``x`` [m]; call it once for each decision."""
        if self._height is None:
            self._height = self._size.height * correlated(self._x, self._size.length, rng)
        moved = 0.0 if self._at is None else abs(x - self._at)
        self.error += self._size.drift * math.sqrt(moved) * float(rng.standard_normal())
        if self._size.jitter:  # without it, no other random number changes
            self._jitter = self._size.jitter * float(rng.standard_normal())
        self._at = x
        # Ground ahead is seen anew, with the error of now.
        self._seen_at[np.searchsorted(self._x, x + NEAREST) :] = self.error

    def apply(self, points: FloatArray, index: Any) -> None:
        """Add the errors to ``points`` (P, 2), in place; x stays in order.

        ``index``: which points of the sampled ground these are, a slice or numbers.
        """
        if self._height is None:
            return
        points[:, 1] += self._height[index]
        displaced = self._seen_at[index] - self.error + self._jitter
        points[:, 0] += np.clip(displaced, -LARGEST, LARGEST)
        np.maximum.accumulate(points[:, 0], out=points[:, 0])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later decisions do not change."""
        return self._height, self._seen_at.copy(), self.error, self._at, self._jitter

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._height, seen_at, self.error, self._at, self._jitter = saved
        self._seen_at[:] = seen_at


def correlated(x: FloatArray, length: float, rng: np.random.Generator) -> FloatArray:
    """Return values of a stationary process of unit variance at ``x``, (P,).

    It is Ornstein and Uhlenbeck's: the correlation of two places is exp(-distance / length).
    """
    # A value keeps a part of the one before, and gains as much noise as the variance loses.
    stays = np.exp(-np.diff(x) / length)
    steps = rng.standard_normal(len(x))
    steps[1:] *= np.sqrt(1 - stays**2)
    series = np.empty(len(x))
    value = 0.0
    for i, (keep, step) in enumerate(zip([0.0, *stays.tolist()], steps.tolist(), strict=True)):
        value = keep * value + step
        series[i] = value
    return series
