"""The robot's own shape in frame R: what its LiDAR sees of itself.

In: points or rays and the angles of the flippers. Out: which points lie within the robot, or how
far the rays reach. Chassis and flippers are boxes as long as the tracks, round ends included.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray

_CIRCLES = 21
"""Circles that stand for the outline of the chassis or of a flipper [-]."""


class _Box(NamedTuple):
    """A box that is turned about the y axis."""

    x: float
    """Position of its centre in frame R [m]."""
    z: float
    """Height of its centre in frame R [m]."""
    half_length: float
    """Half its length, along the turned x axis [m]."""
    inner: float
    """Smallest distance of its parts from the middle plane of the robot [m]."""
    outer: float
    """Largest distance of its parts from the middle plane of the robot [m]."""
    tilt: float
    """Angle of its x axis above that of frame R [rad]."""


@dataclass(frozen=True)
class Body:
    """Lengths of the robot, all in [m]."""

    chassis_length: float
    """Length of the chassis, round ends included."""
    flipper_length: float
    """Length of a flipper, round ends included."""
    track_radius: float
    """Radius of the tracks' round ends."""
    chassis_width: float
    """Width of the chassis between the flippers."""
    overall_width: float
    """Width over the outer sides of the flippers."""

    def contains(
        self, points: FloatArray, front: float, rear: float, margin: float
    ) -> NDArray[np.bool_]:
        """Return which ``points`` (P, 3) [m] lie within the robot or closer than ``margin``."""
        found = np.zeros(len(points), np.bool_)
        reach = self.chassis_length / 2 + self.flipper_length + margin
        near = np.abs(points[:, 1]) <= self.overall_width / 2 + margin
        near &= (np.abs(points[:, 0]) <= reach) & (np.abs(points[:, 2]) <= reach)
        points = points.compress(near, axis=0)
        inside = np.zeros(len(points), np.bool_)
        side, level = np.abs(points[:, 1]), np.ascontiguousarray(points[:, [0, 2]])
        for box in self._boxes(front, rear):
            along, above = _turned(level - (box.x, box.z), box.tilt)
            inside |= (
                (np.abs(along) <= box.half_length + margin)
                & (np.abs(above) <= self.track_radius + margin)
                & (side <= box.outer + margin)
                & (side >= box.inner - margin)
            )
        found[near] = inside
        return found

    def distances(
        self, origin: FloatArray, directions: FloatArray, front: float, rear: float
    ) -> FloatArray:
        """Return the distance from ``origin`` (3,) to the robot along each direction, (R,) [m].

        It is infinite for rays that miss it; ``directions`` are (R, 3) unit vectors in frame R.
        """
        return np.minimum(
            self.distances_to_chassis(origin, directions),
            self.distances_to_flippers(origin, directions, front, rear),
        )

    def distances_to_chassis(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the distances to the chassis alone, (R,), as ``distances`` does [m]."""
        return self._nearest(origin, directions, [self._chassis()])

    def distances_to_flippers(
        self, origin: FloatArray, directions: FloatArray, front: float, rear: float
    ) -> FloatArray:
        """Return the distances to the flippers alone, (R,), as ``distances`` does [m]."""
        return self._nearest(origin, directions, self._flippers(front, rear))

    def may_hit_flippers(self, origin: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Return along which directions a flipper can be hit, at whatever angles, (R,)."""
        length = self.flipper_length - self.track_radius  # from the hinge, without its round end
        farthest = 1e-6 + math.hypot(length, self.track_radius)
        around = [box._replace(half_length=farthest) for box in self._hinges()]
        found = np.zeros(len(directions), np.bool_)
        for enter, leave in _crossed(origin, directions, around, farthest):
            found |= (enter <= leave) & (leave >= 0)
        return found

    def _nearest(
        self, origin: FloatArray, directions: FloatArray, boxes: Iterable[_Box]
    ) -> FloatArray:
        """Return the distances to the nearest of the boxes, (R,), infinite without a hit [m]."""
        nearest = np.full(len(directions), np.inf)
        for enter, leave in _crossed(origin, directions, boxes, self.track_radius):
            hit = (enter <= leave) & (enter > 0)
            nearest[hit] = np.minimum(nearest[hit], enter[hit])
        return nearest

    def circles(self, pitch: float, front: float, rear: float) -> FloatArray:
        """Return the centres of circles that the tracks cover in frame L, (C, 2) x and z [m].

        They lie along chassis and flippers; their radius is that of the tracks.
        """
        hinge = self.chassis_length / 2 - self.track_radius
        axle = self.flipper_length - 2 * self.track_radius
        along = np.linspace(0.0, 1.0, _CIRCLES)[:, None]
        ends = np.array([[-hinge, 0.0], [hinge, 0.0]])
        parts = [ends[0] + along * (ends[1] - ends[0])]
        for end, angle, ahead in ((ends[1], front, 1.0), (ends[0], rear, -1.0)):
            parts.append(end + along * axle * [ahead * math.cos(angle), math.sin(angle)])
        cos, sin = math.cos(pitch), math.sin(pitch)
        return np.asarray(np.concatenate(parts) @ np.array([[cos, sin], [-sin, cos]]))

    def _chassis(self) -> _Box:
        return _Box(0.0, 0.0, self.chassis_length / 2, 0.0, self.chassis_width / 2, 0.0)

    def _hinges(self) -> tuple[_Box, _Box]:
        """Return level boxes that end at the flippers' hinges, front and rear."""
        inner, outer = self.chassis_width / 2, self.overall_width / 2
        hinge = self.chassis_length / 2 - self.track_radius
        front = _Box(hinge, 0.0, self.flipper_length / 2, inner, outer, 0.0)
        return front, front._replace(x=-hinge)

    def _flippers(self, front: float, rear: float) -> Iterator[_Box]:
        middle = self.flipper_length / 2 - self.track_radius  # from the hinge [m]
        for hinge, angle, ahead in zip(self._hinges(), (front, rear), (1.0, -1.0), strict=True):
            x, z = hinge.x + ahead * middle * math.cos(angle), middle * math.sin(angle)
            yield hinge._replace(x=x, z=z, tilt=ahead * angle)

    def _boxes(self, front: float, rear: float) -> Iterator[_Box]:
        yield self._chassis()
        yield from self._flippers(front, rear)


def _crossed(
    origin: FloatArray, directions: FloatArray, boxes: Iterable[_Box], half_height: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield where lines along ``directions`` (R, 3) enter and leave each box, each (R,) [m].

    A line that enters behind where it leaves misses the box. Boxes beside the robot's middle plane
    stand on both sides of it.
    """
    middle = origin[1] == 0.0  # both sides of the robot are then equal
    beside = np.abs(directions[:, 1]) if middle else directions[:, 1]
    for box in boxes:
        begin = _turned(origin[None, [0, 2]] - (box.x, box.z), box.tilt)
        along, above = _turned(directions[:, [0, 2]], box.tilt)
        spans = [
            _span(begin[0][0], along, -box.half_length, box.half_length),
            _span(begin[1][0], above, -half_height, half_height),
        ]
        sides = ((box.inner, box.outer), (-box.outer, -box.inner))
        whole = ((-box.outer, box.outer),)
        for low, high in whole if box.inner <= 0 else sides[:1] if middle else sides:
            both = [*spans, _span(float(origin[1]), beside, low, high)]
            enter = np.maximum.reduce([s for s, _ in both])
            yield enter, np.minimum.reduce([s for _, s in both])


def _turned(vectors: FloatArray, tilt: float) -> tuple[FloatArray, FloatArray]:
    """Return the components of ``vectors`` (V, 2) along and across axes at ``tilt`` [rad]."""
    cos, sin = math.cos(tilt), math.sin(tilt)
    x, z = vectors.T
    return cos * x + sin * z, cos * z - sin * x


def _span(begin: float, rate: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Return where ``begin`` + t · ``rate`` enters and leaves [``low``, ``high``], each (R,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - begin) / rate, (high - begin) / rate
    inside = low <= begin <= high
    still = rate == 0
    enter, leave = np.minimum(one, other), np.maximum(one, other)
    enter[still], leave[still] = (-np.inf, np.inf) if inside else (np.inf, -np.inf)
    return enter, leave
