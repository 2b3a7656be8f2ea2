"""Selects the points of a fine polyline that a rolling track can feel.

In: a polyline whose x never decreases, tolerances [m]. Out: which of its points to keep.
``sim.thinning`` compiles this function; it calls no other, so that it can be compiled as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray


def kept_points(
    points: FloatArray, fixed: NDArray[np.bool_], tolerance: float, span: float
) -> NDArray[np.bool_]:
    """Return which of the (V, 2) points [m] to keep, (V,); ``fixed`` points are always kept.

    After each kept point, the next kept point is the farthest for which the omitted points
    between both either lie within ``tolerance`` [m] of the straight line between them (the cone
    test of Imai and Iri 1988), or all lie below that line, which is then at most ``span`` [m]
    long.
    """
    count = len(points)
    keep = np.zeros(count, dtype=np.bool_)
    keep[0] = True
    start = 0
    while start < count - 1:
        best = start + 1
        low, high, longest = -math.inf, math.inf, 0.0  # directions of lines within the tolerance
        steepest, height = -math.inf, 0.0  # direction and distance of the upper hull's last point
        for j in range(start + 1, count):
            dx, dz = points[j, 0] - points[start, 0], points[j, 1] - points[start, 1]
            distance, direction = math.hypot(dx, dz), math.atan2(dz, dx)
            if low <= direction <= high and distance >= longest:
                best = j
            if direction > steepest or (direction == steepest and distance >= height):
                steepest, height = direction, distance
                if distance <= span:
                    best = j
            if fixed[j]:
                break
            if distance > tolerance:
                half = math.asin(tolerance / distance)
                low, high = max(low, direction - half), min(high, direction + half)
            longest = max(longest, distance)
            if low > high and dx > span:
                break
        start = best
        keep[start] = True
    return keep
