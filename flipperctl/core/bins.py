"""Mean heights of the ground in bins along the robot (paper Eq. 1).

In: points of the ground in frame L. Out: one height for each bin, including empty bins.
``sim.planar.bins`` compiles ``sum_heights``; it calls no other function, so that it can be compiled
as it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation
from flipperctl.core.arrays import FloatArray


def sum_heights(
    points: FloatArray, behind: float, width: float, total: FloatArray, count: FloatArray
) -> int:
    """Sum up the heights of each bin's points and count them; return the number of bins with any.

    ``points`` are (P, 2) in frame L; the first bin begins ``behind`` the chassis centre, and a bin
    is ``width`` long [m]. ``total`` and ``count`` are (N,) zeros.
    """
    seen = 0
    for i in range(len(points)):
        index = min(int((points[i, 0] + behind) / width), len(total) - 1)
        if count[index] == 0:
            seen += 1
        total[index] += points[i, 1]
        count[index] += 1
    return seen


Sum = Callable[[FloatArray, float, float, FloatArray, FloatArray], int]
"""A function like ``sum_heights``."""


def mean_heights(
    points: FloatArray, bins: int, bin_width: float, sum_heights: Sum = sum_heights
) -> FloatArray:
    """Return the mean height of the points of each bin, (N,) in frame L, rear to front [m].

    ``points``: (P, 2) in frame L within ``observation.reach`` [m], in any order. The height of an
    empty bin is interpolated linearly between its neighbours; beyond the outermost bins with
    points it equals theirs. Without any points, every height is 0. ``sum_heights``
    may be a compiled one.
    """
    total, count = np.zeros(bins), np.zeros(bins)
    seen = sum_heights(points, observation.reach(bins, bin_width), bin_width, total, count)
    if seen == bins:
        return total / count
    if not seen:
        return total
    where = np.flatnonzero(count)
    return np.interp(np.arange(bins), where, total[where] / count[where])


def occupied(points: FloatArray, bins: int, bin_width: float) -> NDArray[np.bool_]:
    """Return which bins have points, (N,); ``points`` are (P, 2) as for ``mean_heights`` [m]."""
    index = (points[:, 0] + observation.reach(bins, bin_width)) / bin_width
    found = np.zeros(bins, np.bool_)
    found[np.clip(index.astype(np.int64), 0, bins - 1)] = True
    return found
