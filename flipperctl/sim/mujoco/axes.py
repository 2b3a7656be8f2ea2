"""Rotations of the chassis: from two of its axes, and at the start."""

from __future__ import annotations

import math

import numpy as np

from flipperctl.api import FloatArray

Axis = tuple[float, float, float]


def orientation(ahead: Axis, left: Axis) -> FloatArray:
    """Return the rotation from frame R to world by the chassis' x and y axes, (3, 3)."""
    (a, b, c), (d, e, f) = ahead, left
    return np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])


def quaternion(pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of a chassis that stands on a slope of ``pitch`` and turned on it [rad].

    ``pitch`` is nose up positive; ``yaw`` is the turn to the left about the slope's normal.
    """
    cos, sin = math.cos(pitch / 2), math.sin(pitch / 2)
    w, z = math.cos(yaw / 2), math.sin(yaw / 2)
    return cos * w, 0.0 - sin * z, 0.0 - sin * w, cos * z  # 0.0 minus: no -0.0 on level ground
