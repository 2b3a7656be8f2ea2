"""Lines of sight from the sensor's mount to the ground, and the ground between what was seen.

In: points along the outline of the ground, poses and settings. Out: which points are seen, and the
points that a map with gaps offers. All of it is machine code.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.sim.jit import cached

_GRAZING = 1e-9
"""Difference of two slopes up to which a line of sight along the ground is free [-]."""


@cached(njit)
def mark_seen(
    outline: FloatArray,
    index: NDArray[np.int64],
    pose: tuple[float, float, float],
    mount: tuple[float, float],
    body: float,
    limits: tuple[float, float],
    seen: NDArray[np.bool_],
) -> None:
    """Mark the points to which the line of sight from the mount is free.

    ``outline`` is (M, 2) in world [m], in order along the ground, vertices included; ``index`` (M,)
    is the number of each point in ``seen`` (P,), or -1. ``pose`` is that of the chassis: x, z [m]
    and pitch [rad]; ``mount`` is (x, z) in frame R [m]. The chassis hides what lies below it: the
    ``body`` [m] that is centred in frame R, at z = 0. Points outside the world x ``limits`` [m] are
    not marked.
    """
    x, z, pitch = pose
    cos, sin = math.cos(pitch), math.sin(pitch)
    eye_x, eye_z = x + cos * mount[0] - sin * mount[1], z + sin * mount[0] + cos * mount[1]
    ahead = np.searchsorted(outline[:, 0], eye_x, side="right")
    if 0 < ahead < len(outline):
        (x0, z0), (x1, z1) = outline[ahead - 1], outline[ahead]
        if z0 + (z1 - z0) * (eye_x - x0) / (x1 - x0) >= eye_z:
            return  # the mount is below the ground
    for direction in (1, -1):
        i = ahead if direction == 1 else ahead - 1
        steepest = -math.inf
        while 0 <= i < len(outline) and (
            outline[i, 0] <= limits[1] if direction == 1 else outline[i, 0] >= limits[0]
        ):
            away = max(direction * (outline[i, 0] - eye_x), 1e-9)
            slope = (outline[i, 1] - eye_z) / away
            if slope >= steepest - _GRAZING:
                steepest = max(steepest, slope)
                if index[i] >= 0 and limits[0] <= outline[i, 0] <= limits[1]:
                    dx, dz = outline[i, 0] - x, outline[i, 1] - z
                    along, up = cos * dx + sin * dz, cos * dz - sin * dx
                    if up >= 0 or body / 2 <= abs(
                        mount[0] + (along - mount[0]) * mount[1] / (mount[1] - up)
                    ):  # the line of sight passes the chassis
                        seen[index[i]] = True
            i += direction


@cached(njit)
def known_points(seen: NDArray[np.bool_], low: int, high: int) -> NDArray[np.int64]:
    """Return the numbers of the ``seen`` (P,) points from ``low`` to before ``high``, (K,).

    The nearest seen point on either side, beyond these numbers, is returned as well.
    """
    while low > 0:
        low -= 1
        if seen[low]:
            break
    while high < len(seen):
        high += 1
        if seen[high - 1]:
            break
    return low + np.flatnonzero(seen[low:high])


@cached(njit)
def fill_gaps(
    points: FloatArray,
    index: NDArray[np.int64],
    offered: NDArray[np.bool_],
    spacing: float,
    limits: tuple[float, float],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the offered points with the gaps filled, (P', 2) [m], and which of them are filled.

    ``points`` (P, 2) were seen, in order along the ground, and ``index`` (P,) are their numbers
    along it; numbers are missing where the ground was never seen. There the result has points at
    most ``spacing`` [m] apart on the straight line between both neighbours, level before the first
    and past the last point, within ``limits`` of x [m].
    """
    low, high = limits
    if len(points) == 0:
        return np.empty((0, 2)), np.empty(0, dtype=np.bool_)
    ends = np.empty((len(points) + 2, 2))
    ends[1:-1] = points
    ends[0, 0], ends[0, 1] = min(low, points[0, 0]), points[0, 1]
    ends[-1, 0], ends[-1, 1] = max(high, points[-1, 0]), points[-1, 1]
    counts = np.zeros(len(points) + 1, dtype=np.int64)  # filled points before each seen one
    for i in range(len(counts)):
        if 0 < i < len(points) and index[i] == index[i - 1] + 1:
            continue
        length = math.hypot(ends[i + 1, 0] - ends[i, 0], ends[i + 1, 1] - ends[i, 1])
        counts[i] = max(0, math.ceil(length / spacing - 1e-9) - 1)
    most = counts.sum() + len(points)
    result, filled = np.empty((most, 2)), np.zeros(most, dtype=np.bool_)
    n = 0
    for i in range(len(counts)):
        for k in range(1, counts[i] + 1):
            share = k / (counts[i] + 1)
            x = ends[i, 0] + share * (ends[i + 1, 0] - ends[i, 0])
            if low <= x < high:
                result[n, 0] = x
                result[n, 1] = ends[i, 1] + share * (ends[i + 1, 1] - ends[i, 1])
                filled[n] = True
                n += 1
        if i < len(points) and offered[i]:
            result[n] = points[i]
            n += 1
    return result[:n].copy(), filled[:n].copy()
