"""Constant errors of the devices, by the level ground on which a robot starts.

In: points of the first scan. Out: how much too long distances are, and by how much the pitch errs.
Distances that are all too long lower near ground, which is seen steeply, more than ground far
ahead, so heights that are corrected by ground seen earlier rise or sink without end: by 8 cm in
12 m for 2 cm. A pitch that is 5 mrad too large lets the robot climb 5 cm in 10 m.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.messages import Scan

_SIDE = 0.8
"""Largest distance of the points from the robot's middle plane. Points beside the robot tell both
errors apart, since their distances are longer [m]."""
_ACROSS = 0.05
"""Deviation of the ground's slope across the robot, which is estimated too [rad]."""
_AHEAD = 0.95
"""Farthest point ahead of the chassis centre; there is no edge before it [m]."""
_BETWEEN = 0.35
"""Largest distance from the robot's middle plane of points that it will drive over [m]."""
_ELSEWHERE, _SHARE = 0.04, 0.9
"""Largest distance from the ground of this part of its points, distances that err included [m]."""
_STEEP = 0.3
"""Smallest drop of a ray per its length [-]."""
_APART = 0.08
"""Points farther than this above or below the ground are not on it [m]."""
_FEWEST = 30
"""Points that are needed [-]."""
_LARGEST = 0.05
"""Largest error of the distances that is believed [m]."""
_NOISE, _SHARED = 0.012, 3.0
"""Deviation of a point's height [m], and points that err alike [-]."""
_BIAS = 0.02
"""Deviation of the error of the distances [m]."""


class StartErrors(NamedTuple):
    """Errors at the start."""

    distance: float = 0.0
    """By how much distances are too long [m]."""
    pitch: float = 0.0
    """By how much the pitch is too large [rad]."""


def is_elsewhere(points: FloatArray, lidar: FloatArray, below: float) -> bool:
    """Return whether points show the ground ahead of the robot elsewhere than level.

    ``points`` (P, 3), none of them the robot's own, the ``lidar`` and ``below`` are those of
    ``start_errors``. Too few points show nothing.
    """
    drop, off, ahead = _seen(points, lidar, below, _BETWEEN)
    near = off[ahead & (drop >= _STEEP)]
    return len(near) >= _FEWEST and float(np.quantile(np.abs(near), _SHARE)) > _ELSEWHERE


def start_errors(points: FloatArray, lidar: FloatArray, below: float, tilt: float) -> StartErrors:
    """Return the likely errors; 0 if too few points show the ground.

    ``points`` (P, 3) and the place of the ``lidar`` (3,) are relative to the chassis centre in
    axes that are level by the measured pitch; the ground lies ``below`` the centre [m]. ``tilt``:
    standard deviation of the pitch, 0 if it does not err [rad].
    """
    drop, off, ahead = _seen(points, lidar, below, _SIDE)
    used = ahead & (drop >= _STEEP) & (np.abs(off) <= _APART)
    if used.sum() < _FEWEST:
        return StartErrors()
    slopes = np.column_stack([-drop[used], points[used, 0], points[used, 1]])  # of the height
    prior = np.array([_BIAS, max(tilt, 1e-9), _ACROSS])
    # In units of the deviations, so that a tilt of 0 leaves a regular system.
    scaled = slopes * prior / (_NOISE * np.sqrt(_SHARED))
    target = off[used] / (_NOISE * np.sqrt(_SHARED))
    found = prior * np.linalg.solve(scaled.T @ scaled + np.eye(3), scaled.T @ target)
    if abs(found[0]) > _LARGEST:
        return StartErrors()
    return StartErrors(float(found[0]), float(found[1]) if tilt else 0.0)


def _seen(
    points: FloatArray, lidar: FloatArray, below: float, side: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return drops per length of the rays [-], heights above level [m], and which are close ahead.

    All (P,); ``side``: largest distance from the robot's middle plane [m].
    """
    rays = points - lidar
    length = np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    x, y, z = points.T
    return -rays[:, 2] / length, z + below, (x > lidar[0]) & (x < _AHEAD) & (np.abs(y) <= side)


def without_bias(scan: Scan, bias: float) -> Scan:
    """Return the scan with all distances shorter by ``bias`` [m]."""
    if not bias:
        return scan
    distance = np.linalg.norm(scan.points, axis=1, keepdims=True)
    return replace(scan, points=scan.points * (1 - bias / np.maximum(distance, 2 * abs(bias))))
