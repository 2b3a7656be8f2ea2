"""Heights above the ground at which a track's round end touches it, as machine code."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from flipperctl.api import FloatArray
from flipperctl.sim.jit import cached


@cached(njit)
def inflated(
    line: FloatArray, origin: float, spacing: float, count: int, radius: float
) -> FloatArray:
    """Return the lowest heights of a circle's centre above a polyline, (count,) [m].

    The circle has ``radius`` [m]; its centre is at ``origin`` and every ``spacing`` [m] past it.
    ``line`` is (V, 2) [m] with x that never decreases.
    """
    found = np.full(count, -np.inf)
    for i in range(len(line) - 1):
        x0, z0, x1, z1 = line[i, 0], line[i, 1], line[i + 1, 0], line[i + 1, 1]
        slope = (z1 - z0) / (x1 - x0) if x1 > x0 else 0.0
        steep = math.sqrt(1 + slope * slope)
        low = max(0, math.ceil((x0 - radius - origin) / spacing))
        high = min(count - 1, math.floor((x1 + radius - origin) / spacing))
        for j in range(low, high + 1):
            x = origin + j * spacing
            touched = x + radius * slope / steep
            height = -np.inf
            if x0 < touched < x1:
                height = z0 + slope * (touched - x0) + radius / steep
            if abs(x - x0) <= radius:
                height = max(height, z0 + math.sqrt(radius * radius - (x - x0) ** 2))
            if abs(x - x1) <= radius:
                height = max(height, z1 + math.sqrt(radius * radius - (x - x1) ** 2))
            found[j] = max(found[j], height)
    return found
