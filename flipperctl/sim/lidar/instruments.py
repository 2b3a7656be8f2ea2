"""The instruments of ``perception=lidar``: LiDAR, inertial unit, encoders, tracking system.

In: the true state, rays in the engine's world. Out: messages of ``flipperctl.core.lidar``. A turn
of the LiDAR is cast in parts while the robot moves. It becomes a ``Scan`` of points with their
ages, with errors, mixed returns at edges and losses. The same rays always hit the chassis, and few
can hit a flipper, so neither is computed for all.

An engine may tilt gravity in place of the ground. World's z axis is then not vertical, roll and
pitch are measured against gravity, and world is not a level frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Instrument, RayWorld, RobotState
from flipperctl.core.lidar.body import Body, Mount, attitude, mounting
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Pose, Scan, SpecificForce
from flipperctl.core.targets import angles_of

_VERTICAL = 1e-12
"""Difference of 1 and the z part of the vertical up to which world's z axis is vertical [-]."""


def to_world(state: RobotState) -> FloatArray:
    """Return the rotation from frame R to world."""
    if state.orientation is not None:
        return state.orientation
    return attitude(state.roll, state.pitch, state.yaw)


def upwards(state: RobotState) -> FloatArray:
    """Return the direction against gravity in frame R, (3,)."""
    x, y = math.sin(state.pitch), math.sin(state.roll)
    z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
    return np.array([x, y, math.copysign(z, math.cos(state.pitch))])


def heading(state: RobotState) -> float:
    """Return the heading of a level frame [rad]: about the vertical, and not about world's z."""
    if state.orientation is None:
        return state.yaw
    level = levelled(state)
    if level[2, 2] > 1.0 - _VERTICAL:
        return state.yaw
    ahead = level @ state.orientation[:, 0]
    return math.atan2(ahead[1], ahead[0])


def levelled(state: RobotState) -> FloatArray:
    """Return the rotation from world to level axes, which is the same during an episode.

    The first level axis lies below or above world's x axis.
    """
    if state.orientation is None:
        return np.eye(3)
    up = state.orientation @ upwards(state)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    return np.array([ahead, np.cross(up, ahead), up])


PERIOD = 0.01
"""Time between two measurements [s]."""
_WANDER_TIME = 30.0  # time constant of the slow error of roll and pitch [s]


class InertialUnit(Instrument):
    """Measures the attitude with a slow and a white error, and the rate of the heading."""

    period = PERIOD

    def __init__(
        self,
        tilt_wander: float,
        tilt_noise: float,
        yaw_rate_noise: float,
        yaw_rate_bias: float,
        rng: np.random.Generator,
    ) -> None:
        """Take standard deviations [rad], [rad/s], and the constant error of the episode [rad/s].

        ``rng``: generator of the slow error at the start.
        """
        self._wander, self._noise = tilt_wander, tilt_noise
        self._rate_noise, self._rate_bias = yaw_rate_noise, yaw_rate_bias
        self._tilt: FloatArray = tilt_wander * rng.standard_normal(2)
        self._yaw: float | None = None

    def measure(self, state: RobotState, rng: np.random.Generator) -> Inertial:
        """Return a measurement; the slow error is a first-order Gauss-Markov process."""
        # Always five numbers, so that no setting shifts the draws that follow.
        noise = rng.standard_normal(5)
        stays = math.exp(-PERIOD / _WANDER_TIME)
        self._tilt = stays * self._tilt + self._wander * math.sqrt(1 - stays**2) * noise[:2]
        roll, pitch = (self._tilt + self._noise * noise[2:4]).tolist()
        # The rate is the turn since the last measurement, across ±π as well.
        last, self._yaw = self._yaw, heading(state)
        turned = 0.0 if last is None else math.remainder(self._yaw - last, 2 * math.pi)
        rate = turned / PERIOD + self._rate_bias + self._rate_noise * float(noise[4])
        return Inertial(roll=state.roll + roll, pitch=state.pitch + pitch, yaw_rate=rate)

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of the slow error and of the latest heading."""
        return self._tilt, self._yaw

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._tilt, self._yaw = saved


class Accelerometer(Instrument):
    """Measures the specific force with a constant and a white error."""

    period = PERIOD

    def __init__(self, noise: float, bias: FloatArray, gravity: float) -> None:
        """``noise``: standard deviation; ``bias``: constant error in frame R, (3,); all [m/s²]."""
        self._noise, self._bias, self._gravity = noise, bias, gravity
        self._last: tuple[float, FloatArray] | None = None  # time [s] and velocity [m/s] in world

    def measure(self, state: RobotState, rng: np.random.Generator) -> SpecificForce:
        """Return the mean specific force since the measurement before; at rest at the first one."""
        vx, vz = state.velocity.tolist()
        velocity, last = np.array([vx, state.side_velocity, vz]), self._last
        self._last = state.time, velocity
        # At rest the unit feels gravity alone; a change of velocity is added in frame R.
        force = self._gravity * upwards(state)
        if last is not None and state.time > last[0]:
            force = force + (velocity - last[1]) / (state.time - last[0]) @ to_world(state)
        return SpecificForce(*(force + self._bias + self._noise * rng.standard_normal(3)).tolist())

    def save(self) -> Any:
        """Return a snapshot of the latest velocity."""
        return self._last

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._last = saved


class BeltEncoders(Instrument):
    """Measures the speeds at which the belts run."""

    period = PERIOD

    def __init__(self, speed: float, error: float) -> None:
        """``speed``: of belts that the engine does not steer [m/s]; ``error``: relative [-]."""
        self._speed, self._scale = speed, 1.0 + error

    def measure(self, state: RobotState, rng: np.random.Generator) -> Belts:
        """Return mean and difference of the speeds, with their constant relative error."""
        belts = np.full(2, self._speed) if state.belts is None else state.belts
        left, right = (self._scale * belts).tolist()
        return Belts(speed=(left + right) / 2, difference=right - left)


class Encoders(Instrument):
    """Measures the angles of the flippers."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Joints:
        """Return the true angles: encoders of geared joints err by far less than a policy feels."""
        return Joints(front=state.front, rear=state.rear, flippers=state.flippers)


class Tracking(Instrument):
    """Measures the pose of the robot without error."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Pose:
        """Return the true pose; frame M is the world, levelled if its z axis is not vertical."""
        level = levelled(state)
        x, z = state.position.tolist()
        x, y, z = (level @ [x, state.side, z]).tolist()
        return Pose(x=x, y=y, z=z, roll=state.roll, pitch=state.pitch, yaw=heading(state))


RINGS = 32
"""Number of lasers; each draws a ring [-]."""
_LOWEST, _SPACING = np.radians(2.3125), np.radians(2.8125)
"""Angle of the lowest ring above the base, and between two rings [rad].

By the table of channels in the RS-Bpearl's user manual (2.0.1), from 2.3125° to 89.5°.
"""


def directions(azimuths: int) -> FloatArray:
    """Return a ray for each of ``azimuths`` and ``RINGS``, (R, 3)."""
    above = _LOWEST + _SPACING * np.arange(RINGS)
    around = 2 * np.pi / azimuths * np.arange(azimuths)
    # All rings of an azimuth follow each other.
    height, azimuth = (angles.ravel() for angles in np.meshgrid(above, around))
    flat = np.cos(height)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height)])


class OwnHits:
    """The distances from one place on the robot to its own body along given rays."""

    def __init__(self, body: Body, origin: FloatArray, rays: FloatArray) -> None:
        """``origin`` (3,) [m] and the unit vectors ``rays`` (R, 3) are in frame R."""
        self._body, self._origin = body, origin
        # The distances to the chassis never change in frame R, and few rays can meet a flipper at
        # all.
        self._to_chassis = body.distances_to_chassis(origin, rays)
        self._near = np.flatnonzero(body.may_hit_flippers(origin, rays))
        self._rays = rays[self._near]

    def distances(self, flippers: Sequence[float]) -> FloatArray:
        """Return the distance to the robot along each ray, (R,), infinite if it misses it [m]."""
        distances = self._to_chassis.copy()
        to_flippers = self._body.distances_to_flippers(self._origin, self._rays, flippers)
        distances[self._near] = np.minimum(distances[self._near], to_flippers)
        return distances


_STEEP = math.tan(math.radians(70.0))
"""Neighbouring rays meet two surfaces if the slope between them is above this, and differs by more
from the slope on the other side: on one surface, both are equal [-]."""


@dataclass(frozen=True)
class RangeErrors:
    """Errors of the measured distances."""

    noise: float  # standard deviation [m]
    bias: float  # constant error of the episode [m]
    resolution: float  # step of the distances; 0: none [m]
    dropout: float  # fraction of the returns that are lost [-]
    mixed: float = 0.0
    """Fraction of the returns at depth discontinuities that lie between the two surfaces [-]."""
    mixed_gap: float = 1.0  # farther surfaces do not mix [m]
    grazing: float = 2.0  # angle of incidence at which half of the returns are lost [rad]
    grazing_width: float = 0.1  # range of angles in which the lost fraction rises from 0 to 1 [rad]


class _Neighbours(NamedTuple):
    """The neighbouring rays on one side of each ray, as (A, RINGS) arrays."""

    slope: FloatArray
    """Tangent of the angle of incidence on a plane through both hits, positive if the neighbour is
    farther; NaN without a hit [-]."""
    gap: FloatArray  # by how much the neighbour's distance is larger; NaN without a hit [m]


class Returns:
    """Turns true distances into measured ones."""

    def __init__(self, errors: RangeErrors, azimuths: int) -> None:
        """``azimuths``: number of the rays of each ring in a turn."""
        self._errors, self._azimuths = errors, azimuths
        rays = directions(azimuths).reshape(azimuths, RINGS, 3)
        self._along = _angle(rays[0], rays[1])  # (RINGS,) [rad]
        self._across = _angle(rays[0, :-1], rays[0, 1:])  # (RINGS - 1,) [rad]
        last = errors.grazing - errors.grazing_width / 2
        self._grazes = last < math.pi / 2

    def measured(
        self, true: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the measured distances of a turn [m] and whether they return, each (R,).

        ``true`` (R,) distances are infinite without a hit; all rings of an azimuth follow each
        other.
        """
        errors, count = self._errors, len(true)
        # Drawn for all rays, so that no draw depends on what the others met.
        noise, returned = rng.standard_normal(count), rng.random(count) >= errors.dropout
        if errors.mixed or self._grazes:
            sides = self._sides(true.reshape(self._azimuths, RINGS))
            mixes, between, grazes = rng.random((3, count))
            # Some returns beside an edge lie between its two surfaces.
            gap = np.zeros(count)
            (mixing,) = np.nonzero(mixes < errors.mixed)
            gap[mixing] = _edges([_at(side, mixing) for side in sides], errors.mixed_gap)
            # A ray that meets the ground at a flat angle may not return.
            returned &= grazes >= self._lost(sides)
            true = true + between * gap
        # The step comes last, since the unit rounds what it has measured.
        measured = true + errors.bias + errors.noise * noise
        if errors.resolution:
            measured = errors.resolution * np.round(measured / errors.resolution)
        return measured, returned

    def _lost(self, sides: list[_Neighbours]) -> FloatArray:
        """Return the fraction of the returns that are lost by grazing incidence, (R,)."""
        errors = self._errors
        lost = np.zeros(sides[0].slope.size)
        if not self._grazes:
            return lost
        # The slopes along and across the rings together make the tangent of the angle of incidence.
        tangent = np.hypot(*(_flatter(*sides[i : i + 2]) for i in (0, 2))).ravel()
        # Arctangents are costly, and most rays are far from grazing.
        none_below = errors.grazing - errors.grazing_width / 2 - 1e-9
        (grazing,) = np.nonzero(tangent > math.tan(max(0.0, none_below)))
        incidence = np.arctan(tangent[grazing])
        lost[grazing] = np.clip(0.5 + (incidence - errors.grazing) / errors.grazing_width, 0.0, 1.0)
        return lost

    def _sides(self, true: FloatArray) -> list[_Neighbours]:
        """Return the neighbours on both sides along the rings, then across them."""
        none = np.full((self._azimuths, 1), np.inf)
        above = np.concatenate([true[:, 1:], none], axis=1)
        below = np.concatenate([none, true[:, :-1]], axis=1)
        across = np.append(self._across, self._across[-1])
        return [
            _compared(true, np.roll(true, -1, axis=0), self._along),
            _compared(true, np.roll(true, 1, axis=0), self._along),
            _compared(true, above, across),
            _compared(true, below, across),
        ]


def _at(side: _Neighbours, rays: NDArray[np.int64]) -> _Neighbours:
    """Return the neighbours of some rays, given by their numbers, as (C,) arrays."""
    return _Neighbours(side.slope.ravel()[rays], side.gap.ravel()[rays])


def _angle(first: FloatArray, other: FloatArray) -> FloatArray:
    """Return the angles between unit vectors (V, 3), (V,) [rad]."""
    return np.asarray(2 * np.arcsin(np.linalg.norm(first - other, axis=-1) / 2))


def _compared(true: FloatArray, other: FloatArray, angle: FloatArray) -> _Neighbours:
    """Return how the distances ``other`` of rays at an ``angle`` [rad] beside compare to ``true``.

    On a plane, the inverse of the distance is proportional to the cosine of the angle of incidence,
    from which the tangent of that angle follows.
    """
    with np.errstate(invalid="ignore"):
        both = np.isfinite(true) & np.isfinite(other)
        slope = np.where(both, (np.cos(angle) - true / other) / np.sin(angle), np.nan)
        return _Neighbours(slope, np.where(both, other - true, np.nan))


def _flatter(first: _Neighbours, other: _Neighbours) -> FloatArray:
    """Return the smaller slope of both sides; an edge on one side does not count."""
    slope = np.fmin(np.abs(first.slope), np.abs(other.slope))
    return np.asarray(np.where(np.isnan(slope), 0.0, slope))


def _edges(sides: list[_Neighbours], largest: float) -> FloatArray:
    """Return the gap to the nearest surface behind or before an edge beside each ray, else 0 [m].

    Gaps above ``largest`` do not count.
    """
    nearest = np.full_like(sides[0].gap, np.inf)
    for i, (slope, gap) in enumerate(sides):
        bend = np.abs(slope + sides[i ^ 1].slope)  # on a plane, the slopes are opposite
        edge = (np.abs(slope) > _STEEP) & (bend > _STEEP) & (np.abs(gap) <= largest)
        nearest = np.where(edge & (np.abs(gap) < np.abs(nearest)), gap, nearest)
    return np.asarray(np.where(np.isinf(nearest), 0.0, nearest))


SCAN_PERIOD = 0.1
"""Time of a turn, at 10 turns a second [s]."""


class Scanner(Instrument):
    """Casts the rays of a LiDAR in the engine's world."""

    def __init__(
        self,
        azimuths: int,
        reach: float,
        errors: RangeErrors,
        mount: Mount,
        body: Body,
        world: RayWorld,
        parts: int = 1,
    ) -> None:
        """``reach``: farthest distance that returns [m]; ``body`` casts shadows.

        A turn is cast in so many ``parts``, each from the pose of its instant.
        """
        self.period = SCAN_PERIOD / parts
        self._reach, self._near = reach, mount.near
        self._world = world
        # Mount and rays never change in frame R.
        self._place = np.array([mount.x, 0.0, mount.z])
        self._rays = directions(azimuths)  # all rings of the first azimuth, then of the next one
        self._in_robot = self._rays @ mounting(mount.axis).T
        self._returns = Returns(errors, azimuths)
        # A part is a range of azimuths, with its own hits of the robot.
        borders = [RINGS * (azimuths * part // parts) for part in range(parts + 1)]
        self._parts = [slice(*ends) for ends in pairwise(borders)]
        self._own = [OwnHits(body, self._place, self._in_robot[part]) for part in self._parts]
        self._cast: tuple[tuple[float, FloatArray], ...] | None = None
        """Time [s] and true distances [m] of each part of the turn so far; None: before the first
        turn, in which the robot stands still."""

    def measure(self, state: RobotState, rng: np.random.Generator) -> Scan | None:
        """Return the points of the turn that this instant completes; None: it goes on."""
        # At the start the robot has stood still for a whole turn, so one pose serves all parts.
        if self._cast is None:
            self._cast = ()
            return self._scan(self._distances(state, slice(None), self._own), None, rng)
        # Cast the next part from the pose of this instant.
        number = len(self._cast)
        ranges = self._distances(state, self._parts[number], self._own[number : number + 1])
        self._cast = (*self._cast, (state.time, ranges))
        if len(self._cast) < len(self._parts):
            return None
        # The turn is complete: each point carries its age, by which deskewing moves it.
        times, distances = zip(*self._cast, strict=True)
        self._cast = ()
        ages = np.repeat(state.time - np.array(times), [len(row) for row in distances])
        return self._scan(np.concatenate(distances), ages if len(times) > 1 else None, rng)

    def _distances(self, state: RobotState, part: slice, robot: Sequence[OwnHits]) -> FloatArray:
        """Return the true distances along the rays of a part, infinite without a hit, (R,) [m].

        ``robot``: the distances to the robot itself along these rays, in their order.
        """
        turn = to_world(state)
        x, z = state.position
        origin = np.array([x, state.side, z]) + turn @ self._place
        ground = self._world.cast_rays(origin, self._in_robot[part] @ turn.T, self._reach)
        # Ground or the robot itself stops a ray, whichever is nearer.
        hits = [rays.distances(angles_of(state)) for rays in robot]
        return np.minimum(ground, np.concatenate(hits))

    def _scan(self, true: FloatArray, ages: FloatArray | None, rng: np.random.Generator) -> Scan:
        measured, returned = self._returns.measured(true, rng)
        returned &= (true >= self._near) & (true <= self._reach)
        points = self._rays.compress(returned, axis=0) * measured[returned, None]
        return Scan(points, None if ages is None else ages[returned])

    def save(self) -> Any:
        """Return a snapshot of the turn so far."""
        return self._cast

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._cast = saved
