"""The robot's outlines from the side, capsules and belts as plain arrays, and its colours.

In: a state and the geometry. Out: points in the world frame (x forward, z up) [m], for any drawing
library. A capsule is given by the centres of its rear and its front round end. A belt that drives
forward runs over its top from the rear one to the front one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flipperctl.api import FloatArray, RobotGeometry, RobotState

# Colours for colour-blind readers (Okabe and Ito's), the same in every picture.
CHASSIS, FRONT, REAR = "#0072B2", "#D55E00", "#009E73"
GROUND, EARTH, BELT = "#6E6356", "#E4DED4", "#2B2B2B"


def axles(state: RobotState, robot: RobotGeometry) -> FloatArray:
    """Return the centres of the round ends, (3, 2, 2) in world [m].

    Axes: part (chassis, front, rear), end (rear, front), coordinate (x, z). The hinges of the
    front and the rear flippers are ``[0, 1]`` and ``[0, 0]``; the flippers' tips ``[1, 1]`` and
    ``[2, 0]``. Of four flippers, these are the right ones, and the left ones follow: (5, 2, 2).
    """
    ahead = robot.hinge_offset * _direction(state.pitch)
    front_hinge, rear_hinge = state.position + ahead, state.position - ahead
    parts = [[rear_hinge, front_hinge]]
    sides = [state.flippers[1::2], state.flippers[::2]] if state.flippers else []
    for front, rear in sides or [(state.front, state.rear)]:
        front_tip = front_hinge + robot.flipper_axle * _direction(state.pitch + front)
        rear_tip = rear_hinge - robot.flipper_axle * _direction(state.pitch - rear)
        parts += [[front_hinge, front_tip], [rear_tip, rear_hinge]]
    return np.array(parts)


def outlines(state: RobotState, robot: RobotGeometry, inset: float = 0.0) -> FloatArray:
    """Return the outlines of the parts of ``axles`` as closed polygons, (3, 26, 2) in world [m].

    The outlines are moved inward by ``inset`` [m], as for the inner side of a belt of that
    thickness.
    """
    radius = robot.track_radius - inset
    return np.stack([capsule(a, b, radius) for a, b in axles(state, robot)])


def capsule(rear: ArrayLike, front: ArrayLike, radius: float, arc: int = 13) -> FloatArray:
    """Return the outline of a capsule, (2·arc, 2) in world [m].

    It is a closed polygon with ``arc`` points on each round end, clockwise from the top of the
    rear end.
    """
    length = math.dist(np.asarray(rear), np.asarray(front))
    bend = np.linspace(0.0, math.pi * radius, arc)
    along = np.concatenate([length + bend, 2 * length + math.pi * radius + bend])
    along[-1] = 0.0  # the last point is where the outline begins
    return belt_points(rear, front, radius, np.roll(along, 1))[0]


def belt_length(rear: ArrayLike, front: ArrayLike, radius: float) -> float:
    """Return the circumference of a capsule [m]."""
    return 2 * math.dist(np.asarray(rear), np.asarray(front)) + 2 * math.pi * radius


def belt_points(
    rear: ArrayLike, front: ArrayLike, radius: float, along: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return points of a belt and its unit tangents in the direction of travel, each (S, 2).

    ``along``, (S,) [m], is the distance along the belt, clockwise from the top of the rear end,
    modulo the belt's length. The points have the frame and the unit of ``rear`` and ``front``.
    """
    start, end = np.asarray(rear, dtype=np.float64), np.asarray(front, dtype=np.float64)
    length = math.dist(start, end)
    forward = (end - start) / length if length > 0 else np.array([1.0, 0.0])
    up = np.array([-forward[1], forward[0]])
    half = length + math.pi * radius
    s = np.mod(along, 2 * half)
    lower = s >= half  # the lower half is the upper half rotated by 180°
    s = np.where(lower, s - half, s)
    # Along the straight part first, then around the end
    straight = np.minimum(s, length)[:, None]  # (S, 1) [m]
    turned = ((s - straight[:, 0]) / radius)[:, None]  # (S, 1) [rad]
    normal = np.cos(turned) * up + np.sin(turned) * forward
    tangent = np.cos(turned) * forward - np.sin(turned) * up
    # The lower half begins at the front end and runs backwards.
    sign = np.where(lower, -1.0, 1.0)[:, None]
    origin = np.where(lower[:, None], end, start)
    return origin + sign * (straight * forward + radius * normal), sign * tangent


def belt_marks(
    rear: ArrayLike,
    front: ArrayLike,
    radius: float,
    travel: float,
    spacing: float = 0.08,
    depth: float = 0.03,
) -> FloatArray:
    """Return chevrons on a belt that point in its direction and move with it, (M, 3, 2) [m].

    ``travel`` is the distance that the belt has run since time 0 [m]. The marks are spaced evenly,
    about ``spacing`` [m] apart. Each has a tip half ``depth`` [m] inside the outline, between two
    ends behind it, one on the outline and one ``depth`` inside.
    """
    length = belt_length(rear, front, radius)
    count = max(3, round(length / spacing))
    along = travel + np.arange(count, dtype=np.float64) * (length / count)
    outer, tangent = belt_points(rear, front, radius, along)
    inward = np.column_stack([tangent[:, 1], -tangent[:, 0]])  # right of a clockwise run
    inner = outer + depth * inward
    tip = (outer + inner) / 2 + 0.5 * depth * tangent
    return np.stack([outer, tip, inner], axis=1)


def _direction(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])
