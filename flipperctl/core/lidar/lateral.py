"""The sideways slope of the ground, which would otherwise spread the heights of a profile.

In: points near the robot. Out: their slope to the left. On a slope of 0.2 rad, the ground that the
robot covers spreads by 15 cm from side to side, as much as a step.
"""

from __future__ import annotations

import numpy as np

from flipperctl.core.arrays import FloatArray

_FEWEST = 8
"""Points of a column, and columns, without which no slope is estimated [-]."""
_WIDE = 0.1
"""Standard deviation of the places beside the line that a column needs [m]."""
_LARGEST = 0.7
"""Larger slopes are of edges along the way, not of the ground [-]."""


def lateral_slope(points: FloatArray, cell: float) -> float:
    """Return by how much the ground rises to the left per length [-].

    ``points`` (P, 3) are along the way, beside it and up [m]; ``cell`` is the length of a column
    [m]. It is the median of the columns' slopes, so that obstacles on one side of less than half
    the way do not count; 0 if there are too few.
    """
    if not len(points):
        return 0.0
    number = np.floor(points[:, 0] / cell).astype(np.int64)
    number -= number.min()
    count = np.maximum(np.bincount(number), 1)
    beside, height = (
        points[:, axis] - (np.bincount(number, points[:, axis]) / count)[number] for axis in (1, 2)
    )
    squares = np.bincount(number, beside**2)
    usable = (count >= _FEWEST) & (squares >= _WIDE**2 * count)
    if usable.sum() < _FEWEST:
        return 0.0
    slope = float(np.median(np.bincount(number, beside * height)[usable] / squares[usable]))
    return slope if abs(slope) <= _LARGEST else 0.0


def straightened(points: FloatArray, slope: float) -> FloatArray:
    """Return ``points`` (P, 3) without a sideways slope; heights on the line stay [m]."""
    found = points.copy()
    found[:, 2] -= slope * points[:, 1]
    return found
