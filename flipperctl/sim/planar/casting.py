"""Casts rays at the ground of the side plane.

In: the polyline of the ground, an origin and directions. Out: distances.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray


def distances(
    line: FloatArray, origin: FloatArray, directions: FloatArray, reach: float
) -> FloatArray:
    """Return the distance from ``origin`` to the line along each direction, (R,), in its lengths.

    It is infinite for a ray that does not meet the line within ``reach``. ``line`` is (V, 2) [m],
    its x never decreases; ``origin`` is (2,) [m] and ``directions`` are (R, 2), at most 1 long.
    """
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
    found: FloatArray = np.where(met, t, np.inf).min(axis=1, initial=np.inf)
    return found


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross products of vectors in the plane, over the last axis."""
    found: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found
