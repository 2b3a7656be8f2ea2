"""The robot's own shape in frame R, what its LiDAR sees of itself, and where that is mounted.

In: points or rays and the angles of the flippers. Out: which points lie within the robot, or how
far the rays reach; rotation matrices, (3, 3), whose columns are the axes of the turned frame.
Chassis and flippers are boxes as long as the tracks, round ends included.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray
from flipperctl.core.lidar.messages import Joints
from flipperctl.core.targets import alike, angles_of


def attitude(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the rotation from frame R to a level frame.

    ``roll`` and ``pitch`` are the angles of the chassis' y and x axes above the horizontal, as an
    inclinometer along these axes shows them. ``yaw`` is the heading, to the left [rad].
    """
    cos_p, sin_p, cos_y, sin_y = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    # The y axis is across the x axis: turned about it by this angle, it rises by sin(roll).
    turn = math.asin(min(1.0, max(-1.0, math.sin(roll) / max(abs(cos_p), 1e-9))))
    forward = np.array([cos_y * cos_p, sin_y * cos_p, sin_p])
    level, above = np.array([-sin_y, cos_y, 0.0]), np.array([-cos_y * sin_p, -sin_y * sin_p, cos_p])
    left = math.cos(turn) * level + math.sin(turn) * above
    up = math.cos(turn) * above - math.sin(turn) * level
    return np.column_stack([forward, left, up])


def heading(pitch: float, yaw: float) -> FloatArray:
    """Return the direction of frame R's x axis in a level frame, (3,), as ``attitude`` does."""
    cos_p = math.cos(pitch)
    return np.array([math.cos(yaw) * cos_p, math.sin(yaw) * cos_p, math.sin(pitch)])


def mounting(axis: float) -> FloatArray:
    """Return the rotation from frame S to frame R.

    ``axis`` is the elevation of the z axis of S: π/2 is up, 0 ahead, -π/2 down [rad].
    """
    cos, sin = math.cos(axis), math.sin(axis)
    return np.array([[sin, 0.0, cos], [0.0, 1.0, 0.0], [-cos, 0.0, sin]])


T = TypeVar("T", float, FloatArray)


def turned(x: T, y: T, angle: float) -> tuple[T, T]:
    """Return the components of the vectors (x, y) along axes turned by this angle [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


_CIRCLES = 21  # circles that stand for the outline of the chassis or of a flipper [-]


class _Box(NamedTuple):
    """A box that is turned about the y axis."""

    x: float  # position of its centre in frame R [m]
    z: float  # height of its centre in frame R [m]
    half_length: float  # half its length, along the turned x axis [m]
    inner: float  # smallest distance of its parts from the middle plane of the robot [m]
    outer: float  # largest distance of its parts from the middle plane of the robot [m]
    tilt: float  # angle of its x axis above the x axis of frame R [rad]
    side: int = 0  # 1: on the left of that plane alone, -1: on the right alone, 0: on both


@dataclass(frozen=True)
class Body:
    """Lengths of the robot, all in [m]."""

    chassis_length: float  # length of the chassis, round ends included
    flipper_length: float  # length of a flipper, round ends included
    track_radius: float  # radius of the tracks' round ends
    chassis_width: float  # width of the chassis between the flippers
    overall_width: float  # width over the outer sides of the flippers

    def contains(
        self, points: FloatArray, flippers: Sequence[float], margin: float
    ) -> NDArray[np.bool_]:
        """Return which ``points`` (P, 3) [m] lie within the robot or closer than ``margin``.

        ``flippers``: angles of the joints, (J,) [rad].
        """
        # Most points lie far from the robot; a coarse box drops them before the exact shapes.
        result = np.zeros(len(points), np.bool_)
        reach = self.chassis_length / 2 + self.flipper_length + margin
        near = np.abs(points[:, 1]) <= self.overall_width / 2 + margin
        near &= (np.abs(points[:, 0]) <= reach) & (np.abs(points[:, 2]) <= reach)
        points = points.compress(near, axis=0)
        inside = np.zeros(len(points), np.bool_)
        x, y, z = np.ascontiguousarray(points.T)
        both = np.abs(y)
        for box in (self._chassis, *self._flippers(flippers)):
            side = box.side * y if box.side else both
            along, above = turned(x - box.x, z - box.z, box.tilt)
            inside |= (
                (np.abs(along) <= box.half_length + margin)
                & (np.abs(above) <= self.track_radius + margin)
                & (side <= box.outer + margin)
                & (side >= box.inner - margin)
            )
        result[near] = inside
        return result

    def distances_to_chassis(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the distance from ``origin`` (3,) to the chassis along each direction, (R,) [m].

        It is infinite for rays that miss it; ``directions`` are (R, 3) unit vectors in frame R.
        """
        return self._nearest(origin, directions, [self._chassis])

    def distances_to_flippers(
        self, origin: FloatArray, directions: FloatArray, flippers: Sequence[float]
    ) -> FloatArray:
        """Return the distances to the flippers, (R,), as ``distances_to_chassis`` does [m]."""
        return self._nearest(origin, directions, self._flippers(flippers))

    def may_hit_flippers(self, origin: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Return along which directions a flipper can be hit, at whatever angles, (R,)."""
        # Whatever its angle, a flipper lies within a circle about its hinge.
        length = self.flipper_length - self.track_radius  # from the hinge, without its round end
        farthest = 1e-6 + math.hypot(length, self.track_radius)
        around = [box._replace(half_length=farthest) for box in self._hinges()]
        hit = np.zeros(len(directions), np.bool_)
        for enter, leave in _crossed(origin, directions, around, farthest):
            hit |= (enter <= leave) & (leave >= 0)
        return hit

    def _nearest(
        self, origin: FloatArray, directions: FloatArray, boxes: Iterable[_Box]
    ) -> FloatArray:
        """Return the distances to the nearest of the boxes, (R,), infinite without a hit [m]."""
        nearest = np.full(len(directions), np.inf)
        for enter, leave in _crossed(origin, directions, boxes, self.track_radius):
            hit = (enter <= leave) & (enter > 0)
            nearest[hit] = np.minimum(nearest[hit], enter[hit])
        return nearest

    def circles(self, pitch: float, flippers: Sequence[float]) -> FloatArray:
        """Return the centres of circles that the tracks cover in frame L, (C, 2) x and z [m].

        They lie along chassis and flippers, with the radius of the tracks.
        """
        # The chassis, then each flipper from its hinge to its tip
        hinge = self.chassis_length / 2 - self.track_radius
        axle = self.flipper_length - 2 * self.track_radius
        along = np.linspace(0.0, 1.0, _CIRCLES)[:, None]
        ends = np.array([[-hinge, 0.0], [hinge, 0.0]])
        parts = [ends[0] + along * (ends[1] - ends[0])]
        places = (ends[1], 1.0), (ends[0], -1.0)
        for (end, ahead), angle in zip(alike(places, len(flippers)), flippers, strict=True):
            parts.append(end + along * axle * [ahead * math.cos(angle), math.sin(angle)])

        # Frame R to frame L: only the pitch is between them.
        cos, sin = math.cos(pitch), math.sin(pitch)
        return np.asarray(np.concatenate(parts) @ np.array([[cos, sin], [-sin, cos]]))

    @property
    def _chassis(self) -> _Box:
        return _Box(0.0, 0.0, self.chassis_length / 2, 0.0, self.chassis_width / 2, 0.0)

    def _hinges(self) -> tuple[_Box, _Box]:
        """Return level boxes that end at the flippers' hinges, front and rear."""
        inner, outer = self.chassis_width / 2, self.overall_width / 2
        hinge = self.chassis_length / 2 - self.track_radius
        front = _Box(hinge, 0.0, self.flipper_length / 2, inner, outer, 0.0)
        return front, front._replace(x=-hinge)

    def _flippers(self, angles: Sequence[float]) -> Iterator[_Box]:
        """Yield the box of each joint, on both sides if it turns a pair."""
        middle = self.flipper_length / 2 - self.track_radius  # from the hinge [m]
        front, rear = self._hinges()
        hinges = alike(((front, 1.0), (rear, -1.0)), len(angles))
        sides = (0, 0) if len(angles) == 2 else (1, -1, 1, -1)
        for (hinge, ahead), angle, side in zip(hinges, angles, sides, strict=True):
            x, z = hinge.x + ahead * middle * math.cos(angle), middle * math.sin(angle)
            yield hinge._replace(x=x, z=z, tilt=ahead * angle, side=side)


def _crossed(
    origin: FloatArray, directions: FloatArray, boxes: Iterable[_Box], half_height: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield where lines along ``directions`` (R, 3) enter and leave each box, each (R,) [m].

    A line that enters behind where it leaves misses the box. Boxes beside the robot's middle plane
    stand on both sides of it, unless they have a side.
    """
    mirrored = np.abs(directions[:, 1])
    for box in boxes:
        # In the middle plane both sides of the robot are equal.
        middle = origin[1] == 0.0 and not box.side
        sideways = mirrored if middle else directions[:, 1]
        x, z = turned(float(origin[0]) - box.x, float(origin[2]) - box.z, box.tilt)
        along, above = turned(directions[:, 0], directions[:, 2], box.tilt)
        spans = [
            _span(x, along, -box.half_length, box.half_length),
            _span(z, above, -half_height, half_height),
        ]
        sides = [(box.inner, box.outer), (-box.outer, -box.inner)]
        if box.inner <= 0:
            sides = [(-box.outer, box.outer)]
        elif box.side or middle:
            sides = sides[1:] if box.side < 0 else sides[:1]
        for low, high in sides:
            both = [*spans, _span(float(origin[1]), sideways, low, high)]
            enter = np.maximum.reduce([s for s, _ in both])
            yield enter, np.minimum.reduce([s for _, s in both])


def _span(begin: float, rate: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Return where ``begin`` + t · ``rate`` enters and leaves [``low``, ``high``], each (R,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        at_low, at_high = (low - begin) / rate, (high - begin) / rate
    # Parallel to the slab: inside it for ever, or never
    inside = low <= begin <= high
    still = rate == 0
    enter, leave = np.minimum(at_low, at_high), np.maximum(at_low, at_high)
    enter[still], leave[still] = (-np.inf, np.inf) if inside else (np.inf, -np.inf)
    return enter, leave


@dataclass(frozen=True)
class Mount:
    """Where the LiDAR is on the robot, and which of its points count."""

    x: float
    """Position ahead of the chassis centre, along the chassis [m]."""
    z: float
    """Height above the chassis centre [m]."""
    axis: float
    """Elevation of the axis of its rings [rad]."""
    near: float
    """Points closer than this to the LiDAR are dropped [m]."""
    margin: float
    """Points closer than this to the robot's own shape are dropped [m]."""

    @cached_property
    def position(self) -> FloatArray:
        """Position of the LiDAR, (3,) in frame R [m]."""
        return np.array([self.x, 0.0, self.z])

    @property
    def tells_rays(self) -> bool:
        """Whether rays begin there; clouds in frame R do not tell where theirs do."""
        return bool(self.position.any())

    @cached_property
    def turn(self) -> FloatArray:
        """Rotation from the LiDAR's frame to frame R, (3, 3)."""
        return mounting(self.axis)

    def ground_points(
        self, points: FloatArray, body: Body, joints: Joints
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the points that are not the robot's own, (P, 3) in frame R [m], and which, (N,).

        ``points`` (N, 3) are in the LiDAR's frame [m].
        """
        x, y, z = points.T
        mask = np.asarray(x * x + y * y + z * z >= self.near**2)
        points = self.position + points.compress(mask, axis=0) @ self.turn.T
        others = ~body.contains(points, angles_of(joints), self.margin)
        mask[mask] = others
        return points.compress(others, axis=0), mask
