"""Sums of the sensed points' heights by bin, as machine code."""

from __future__ import annotations

from numba import njit

from flipperctl.api import FloatArray
from flipperctl.sim.jit import cached


@cached(njit)
def sum_bins(
    points: FloatArray, reach: float, width: float, total: FloatArray, count: FloatArray
) -> int:
    """Sum up the heights of each bin's points and count them; return the number of bins with any.

    ``points`` are (P, 2) in frame L within ``reach`` [m]; ``total`` and ``count`` are (N,) zeros.
    """
    seen = 0
    for i in range(len(points)):
        index = min(int((points[i, 0] + reach) / width), len(total) - 1)
        if count[index] == 0:
            seen += 1
        total[index] += points[i, 1]
        count[index] += 1
    return seen
