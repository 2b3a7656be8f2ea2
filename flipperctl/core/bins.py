"""Mean heights of the ground in bins along the robot (paper Eq. 1).

In: points of the ground in frame L. Out: one height for each bin, including empty bins.
"""

from __future__ import annotations

import numpy as np

from flipperctl.core import observation
from flipperctl.core.arrays import FloatArray


def mean_heights(points: FloatArray, bins: int, bin_width: float) -> FloatArray:
    """Return the mean height of the points of each bin, (N,) in frame L, rear to front [m].

    ``points``: (P, 2) in frame L within ``observation.reach`` [m], in any order. The height of an
    empty bin is interpolated linearly between its neighbours; beyond the outermost bins with
    points it equals theirs. Without any points, every height is 0.
    """
    behind = observation.reach(bins, bin_width)
    index = np.minimum(((points[:, 0] + behind) / bin_width).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    total = np.bincount(index, points[:, 1], minlength=bins)
    where = np.flatnonzero(count)
    if len(where) == bins:
        return total / count
    if not len(where):
        return np.zeros(bins)
    return np.interp(np.arange(bins), where, total[where] / count[where])
