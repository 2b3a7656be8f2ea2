"""What a robot and its ground look like in 3-D, as coloured triangles for any viewer.

In: the robot, the widths of its tracks, the strips of the ground. Out: meshes, the robot's in the
frames of its bodies. Nothing here needs MuJoCo, and nothing here is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, RobotGeometry
from flipperctl.sim.mujoco.ground import Strip
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.outline import BELT, CHASSIS, EARTH, FRONT, GROUND, REAR, belt_points, capsule

_TREAD, _RISER, _CUT, _RULE = "#DDD6CA", "#9A8D7B", EARTH, "#B4AA9A"
_STEPS = ("#A89C8A", "#B3A797", "#BDB3A4", "#C8BFB1", "#D2CABE", _TREAD)
"""Colours of a surface from its lowest to its highest parts."""
_DECK = "#3E8FC4"
SKY = "#EDF2F7"
SUN = (-0.25, 0.45, -1.0)
"""Direction of the light: it shines on treads and not on the risers ahead."""
GROUSER = 0.02, 0.012, "#5A5A5A"
"""Length and height [m] and colour of the bars on belts."""
_STEEP = math.radians(50)  # least slope of ground that has the colour of risers [rad]
_SHARP = math.radians(15)  # least angle of an edge that is drawn [rad]
_EDGE, _LINE = 0.012, 0.006  # width of the lines of edges, and of those across the ground [m]
_APART = 0.5  # distance of the lines across the ground [m]
_DEEP = 1.5  # ground below the lowest point [m]
_RIM = 0.28  # thickness of a belt, of the radius, as in drawings from the side [-]
_PROUD = 0.004  # height of side plates over belts, and of lines over the ground [m]
_PITCH = 0.084  # distance of the grousers of a belt [m]


class Mesh(NamedTuple):
    """Flat triangles of one colour."""

    triangles: FloatArray  # (F, 3, 3) x, y, z of each corner, anticlockwise from outside [m]
    colour: str  # as in HTML
    shades: bool = True
    """Whether it casts a shadow; treads would shade what risers do, and speckle themselves."""

    def slanted(self, slant: float) -> Mesh:
        """Return the mesh moved ahead by ``slant`` for each metre to the left [-]."""
        moved = self.triangles + self.triangles[..., 1:2] * (slant, 0.0, 0.0)
        return self._replace(triangles=moved)


class Track(NamedTuple):
    """A track in the frame of its body: x ahead, y to the left, z up."""

    body: str
    rear: tuple[float, float]  # x and z of the centre of its rear round end [m]
    front: tuple[float, float]  # of its front round end [m]
    low: float  # y of its right side [m]
    high: float  # y of its left side [m]
    colour: str


def tracks(robot: RobotGeometry, sim: MujocoSettings) -> Iterator[Track]:
    """Yield the main tracks, of the body ``chassis``, and the flippers, such as ``front_left``."""
    half, reach, width = robot.hinge_offset, robot.flipper_axle, sim.track_width / 2
    for side, sign in (("left", 1.0), ("right", -1.0)):
        y = sign * sim.main_track_offset
        yield Track("chassis", (-half, 0.0), (half, 0.0), y - width, y + width, CHASSIS)
        yield Track(f"front_{side}", (0.0, 0.0), (reach, 0.0), -width, width, FRONT)
        yield Track(f"rear_{side}", (-reach, 0.0), (0.0, 0.0), -width, width, REAR)


def robot_meshes(robot: RobotGeometry, sim: MujocoSettings) -> Iterator[tuple[str, Mesh]]:
    """Yield bodies with a mesh: belts, their side plates, and the deck of the chassis."""
    radius = robot.track_radius
    # Belts, with plates on both sides that leave the rim of the belt visible
    for body, rear, front, low, high, colour in tracks(robot, sim):
        yield body, Mesh(_prism(capsule(rear, front, radius), low, high), BELT)
        plate = capsule(rear, front, (1 - _RIM) * radius)
        yield body, Mesh(_prism(plate, low - _PROUD, high + _PROUD), colour)
    # The deck, which slopes down at the front
    half, top = 0.8 * robot.hinge_offset, 1.5 * radius
    deck = [[-half, 0.0], [-half, 0.9 * top], [-0.9 * half, top], [0.7 * half, top], [half, radius]]
    width = sim.main_track_offset + 0.1 * sim.track_width
    yield "chassis", Mesh(_prism(np.array([*deck, [half, 0.0]]), -width, width), _DECK)


def grousers(track: Track, robot: RobotGeometry, travel: float) -> tuple[FloatArray, FloatArray]:
    """Return the places (G, 2) x and z [m] of a belt's bars, and their slopes (G,) [rad].

    ``travel``: how far the belt has run [m].
    """
    length = 2 * math.dist(track.rear, track.front) + 2 * math.pi * robot.track_radius
    count = round(length / _PITCH)
    along = travel + np.arange(count, dtype=np.float64) * (length / count)
    places, ahead = belt_points(track.rear, track.front, robot.track_radius, along)
    return places, np.arctan2(ahead[:, 1], ahead[:, 0])


def ground_meshes(
    strips: Sequence[Strip], low: float, high: float, deep: float = _DEEP
) -> list[Mesh]:
    """Return the ground between two y [m]: treads, risers, cut sides, edges and a rule.

    A surface is the lighter the higher it is, in steps. ``deep``: ground below the lowest point
    [m].
    """
    base = min(float(strip.line[:, 1].min()) for strip in strips) - deep
    lowest, highest = base + deep, max(float(strip.line[:, 1].max()) for strip in strips)
    by_colour: dict[str, list[FloatArray]] = {}

    def add(colour: str, *parts: FloatArray) -> None:
        by_colour.setdefault(colour, []).extend(parts)

    for strip in strips:
        right, left = max(strip.low, low), min(strip.high, high)
        if right >= left:
            continue
        # Faces between the points of the outline, and the cut through the earth below them
        line = strip.line[np.concatenate([[True], np.diff(strip.line, axis=0).any(axis=1)])]
        slopes = np.arctan2(*np.diff(line, axis=0).T[::-1])  # (V - 1,) [rad]
        for (a, b), slope in zip(pairwise(line), slopes.tolist(), strict=True):
            height = (float(a[1] + b[1]) / 2 - lowest) / (highest - lowest or 1.0)
            tread = _STEPS[int(height * (len(_STEPS) - 1) + 0.5)] if len(strips) > 1 else _TREAD
            add(_RISER if abs(slope) > _STEEP else tread, _top(a, b, right, left))
            if b[0] > a[0]:
                below = np.array([[a[0], base], a, b, [b[0], base]])
                add(_CUT, _prism(below, right, left, sides=False))
        # Dark lines along sharp edges
        for i in np.flatnonzero(np.abs(np.diff(slopes)) > _SHARP) + 1:
            add(GROUND, _bar(line[i], line[i], right, left))
        # Light lines across the ground, as a rule for distances
        for x in np.arange(math.ceil(line[0, 0] / _APART), line[-1, 0] / _APART) * _APART:
            at = np.array([x, np.interp(x, *line.T)])
            add(_RULE, _bar(at, at, right, left, _LINE))
    return [
        Mesh(np.concatenate(parts), colour, shades=colour not in _STEPS)
        for colour, parts in by_colour.items()
    ]


def profile_line(strips: Sequence[Strip], y: float) -> Mesh:
    """Return a line along the ground's profile at one y [m], for ground that is cut there."""
    line = next(strip.line for strip in strips if strip.low <= y < strip.high)
    bars = [_bar(a, b, y - _PROUD, y + _EDGE) for a, b in pairwise(line) if (a != b).any()]
    return Mesh(np.concatenate(bars), GROUND)


def _top(a: FloatArray, b: FloatArray, low: float, high: float) -> FloatArray:
    """Return the face from ``a`` to ``b`` (x, z), between two y, (2, 3, 3)."""
    corners = [(*p[:1], y, *p[1:]) for p, y in ((a, low), (b, low), (b, high), (a, high))]
    return np.array([corners[:3], [corners[0], *corners[2:]]])


def _prism(polygon: FloatArray, low: float, high: float, *, sides: bool = True) -> FloatArray:
    """Return a convex ``polygon`` (P, 2) of x and z, clockwise, between two y, (F, 3, 3)."""
    x, z = polygon.T
    right, left = (np.column_stack([x, np.full(len(x), y), z]) for y in (low, high))
    # Both ends are fans of triangles, with opposite turns so that each faces outwards.
    fan = [(0, i, i + 1) for i in range(1, len(x) - 1)]
    ends = [*(right[[i, k, j]] for i, j, k in fan), *(left[[i, j, k]] for i, j, k in fan)]
    around = pairwise([*polygon, polygon[0]]) if sides else ()
    return np.concatenate([np.array(ends), *(_top(a, b, low, high) for a, b in around)])


def _bar(a: FloatArray, b: FloatArray, low: float, high: float, width: float = _EDGE) -> FloatArray:
    """Return a bar around the line from ``a`` to ``b`` (x, z), between two y."""
    ahead = (b - a) / length if (length := math.dist(a, b)) else np.array([1.0, 0.0])
    along, up = ahead * width / 2, np.array([-ahead[1], ahead[0]]) * width / 2
    return _prism(
        np.array([a - along - up, a - along + up, b + along + up, b + along - up]), low, high
    )
