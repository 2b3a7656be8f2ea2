"""Rays to the ground of the side plane, and the filling of its gaps, as machine code.

In: the polyline of the ground, poses and settings. Out: distances, which points are seen, and the
points of the ground with its gaps filled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray, RobotState
from flipperctl.api.jit import cached
from flipperctl.core import observation

add_heights = cached(njit)(observation.add_heights)
fill_gaps = cached(njit)(observation.fill_gaps)
"""``core.observation.add_heights`` and ``fill_gaps``, compiled."""


def distances(
    line: FloatArray, origin: FloatArray, directions: FloatArray, reach: float
) -> FloatArray:
    """Return the distance from ``origin`` to the line along each direction, (R,), in its lengths.

    It is infinite for a ray that does not meet the line within ``reach``. ``line`` is (V, 2) [m],
    its x never decreases; ``origin`` is (2,) [m] and ``directions`` are (R, 2), at most 1 long.
    """
    # The line's x never decreases, so that the segments within reach are a range.
    low = max(1, int(np.searchsorted(line[:, 0], origin[0] - reach)))
    high = int(np.searchsorted(line[:, 0], origin[0] + reach, side="right"))
    near = line[low - 1 : high + 1] - origin
    begin, along = near[:-1], np.diff(near, axis=0)  # (S, 2) [m]
    # A ray t·d meets a segment b + s·e where t = (b × e) / (d × e) and s = (b × d) / (d × e).
    turn = _cross(directions[:, None], along)  # (R, S)
    with np.errstate(divide="ignore", invalid="ignore"):  # along a segment, which it never meets
        t = _cross(begin, along) / turn
        s = _cross(begin, directions[:, None]) / turn
        met = (t >= 0) & (t <= reach) & (s >= 0) & (s <= 1)
    nearest: FloatArray = np.where(met, t, np.inf).min(axis=1, initial=np.inf)
    return nearest


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross products of vectors in the plane, over the last axis."""
    product: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


_GRAZING = 1e-9
"""Largest difference of two slopes at which a line of sight along the ground is free [-]."""
_BEHIND = 10.0  # range of the sensor behind the robot [m]; ahead it is the horizon


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
    is the number of each point in ``seen`` (P,), or -1. ``pose`` of the chassis: x, z [m] and pitch
    [rad]. ``mount`` is (x, z) in frame R [m]. The chassis hides what lies below it; its length is
    ``body`` [m], centred in frame R at z = 0. Points outside the world x ``limits`` [m] are not
    marked.
    """
    x, z, pitch = pose
    cos, sin = math.cos(pitch), math.sin(pitch)
    eye_x, eye_z = x + cos * mount[0] - sin * mount[1], z + sin * mount[0] + cos * mount[1]
    ahead = np.searchsorted(outline[:, 0], eye_x, side="right")
    if 0 < ahead < len(outline):
        (x0, z0), (x1, z1) = outline[ahead - 1], outline[ahead]
        if z0 + (z1 - z0) * (eye_x - x0) / (x1 - x0) >= eye_z:
            return  # the mount is below the ground
    # Outwards on both sides, a point is seen unless it lies below the steepest line of sight so
    # far.
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
    """Return the numbers of the ``seen`` (P,) points in [``low``, ``high``), (K,).

    The nearest seen point on either side of this range is included.
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


class Mast(NamedTuple):
    """Mount and range of the ranging sensor."""

    mount: tuple[float, float]  # position (x, z) of the sensor in frame R [m]
    body_length: float  # length of the chassis, which hides the ground below it [m]
    horizon: float  # range ahead of the robot [m]


class SeenGround:
    """Remembers which points of the sampled outline a line of sight has reached."""

    def __init__(self, cloud: FloatArray, spacing: float, vertices: FloatArray, mast: Mast) -> None:
        """Begin with none of ``cloud`` seen, (P, 2), ``spacing`` apart along ``vertices`` [m]."""
        # Edges between two sampled points hide the ground too, so the vertices are added.
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices, axis=0).T))])
        at = np.concatenate([np.arange(len(cloud)) * spacing, along])  # (M,) [m]
        order = np.argsort(at, kind="stable")
        self._outline = np.concatenate([cloud, vertices])[order]
        self._index = np.where(order < len(cloud), order, -1)
        self._mast = mast
        self.seen = np.zeros(len(cloud), dtype=np.bool_)
        """Which points of the cloud were seen, (P,)."""

    def scan(self, state: RobotState) -> None:
        """Cast rays from the mount and remember the points that they reach."""
        x, z = state.position.tolist()
        mount, body, horizon = self._mast
        pose, limits = (x, z, float(state.pitch)), (x - _BEHIND, x + horizon)
        mark_seen(self._outline, self._index, pose, mount, body, limits, self.seen)
