"""The rotation of the chassis from two of its axes."""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray

Axis = tuple[float, float, float]


def orientation(ahead: Axis, left: Axis) -> FloatArray:
    """Return the rotation from frame R to world by the chassis' x and y axes, (3, 3)."""
    (a, b, c), (d, e, f) = ahead, left
    return np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
