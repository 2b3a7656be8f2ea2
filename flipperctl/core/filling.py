"""Fills unseen ground with points on straight lines between the seen points.

In: seen points in order along the ground. Out: seen and filled points.
``sim.planar.rays`` compiles this function.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray


def fill_gaps(
    points: FloatArray,
    index: NDArray[np.int64],
    offered: NDArray[np.bool_],
    spacing: float,
    limits: tuple[float, float],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the offered points with the gaps filled, (P', 2) [m], and which of them are filled.

    ``points`` (P, 2) are the seen points in order along the ground; ``index`` (P,) are their
    numbers along it, with gaps where the ground is unseen. A gap is filled with points at most
    ``spacing`` [m] apart on the straight line between both neighbours, or at the height of the
    first or last point beyond it, within the ``limits`` of x [m]. ``offered`` (P,): whether a seen
    point is returned.
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
