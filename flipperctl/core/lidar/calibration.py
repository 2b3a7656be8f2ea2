"""The constant error of a LiDAR's distances, by the level ground on which a robot starts.

In: points and the LiDAR's height. Out: how much too long the distances are. Distances that are all
too long lower near ground, which is seen steeply, more than ground far ahead. Heights that are
corrected by ground seen earlier then rise or sink without end: by 8 cm in 12 m for an error of 2 cm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.messages import Scan

_SIDE = 0.36
"""Largest distance of the points from the robot's middle plane [m]."""
_STEEP = 0.3
"""Smallest drop of a ray per its length; flatter ones feel an error of the tilt more [-]."""
_APART = 0.08
"""Points farther than this above or below the ground are not on it [m]."""
_FEWEST = 30
"""Points that are needed [-]."""
_LARGEST = 0.05
"""Largest error that is believed [m]."""


def range_bias(points: FloatArray, height: float) -> float:
    """Return by how much distances are too long; 0 if that cannot be told [m].

    ``points`` (P, 3) relative to the LiDAR in level axes, ``height`` of the LiDAR above the level
    ground on which the robot stands [m].
    """
    ahead = (np.abs(points[:, 1]) <= _SIDE) & (points[:, 0] > 0)
    points = points[ahead & (np.abs(points[:, 2] + height) <= _APART)]
    distance = np.linalg.norm(points, axis=1)
    drop = -points[:, 2] / np.maximum(distance, 1e-9)
    steep = drop >= _STEEP
    if steep.sum() < _FEWEST:
        return 0.0
    bias = float(np.median(distance[steep] - height / drop[steep]))
    return bias if abs(bias) <= _LARGEST else 0.0


def without_bias(scan: Scan, bias: float) -> Scan:
    """Return the scan with all distances shorter by ``bias`` [m]."""
    if not bias:
        return scan
    distance = np.linalg.norm(scan.points, axis=1, keepdims=True)
    return replace(scan, points=scan.points * (1 - bias / np.maximum(distance, 2 * abs(bias))))
