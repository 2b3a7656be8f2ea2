"""Rotations between the frames of the robot, the LiDAR and the map.

In: angles. Out: rotation matrices, (3, 3); their columns are the axes of the turned frame.
"""

from __future__ import annotations

import math

import numpy as np

from flipperctl.core.arrays import FloatArray


def attitude(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the rotation from frame R to a level frame.

    ``roll`` and ``pitch`` are the angles of the chassis' y and x axes above the horizontal, so that
    both are what an inclinometer along these axes shows; ``yaw`` is the heading, to the left [rad].
    """
    cos_p, sin_p, cos_y, sin_y = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    # The y axis is across the x axis: turned about it by this angle, it rises by sin(roll).
    turn = math.asin(min(1.0, max(-1.0, math.sin(roll) / max(abs(cos_p), 1e-9))))
    forward = np.array([cos_y * cos_p, sin_y * cos_p, sin_p])
    level, above = np.array([-sin_y, cos_y, 0.0]), np.array([-cos_y * sin_p, -sin_y * sin_p, cos_p])
    left = math.cos(turn) * level + math.sin(turn) * above
    up = math.cos(turn) * above - math.sin(turn) * level
    return np.column_stack([forward, left, up])


def heading(pitch: float, yaw: float) -> FloatArray:
    """Return the direction of frame R's x axis in a level frame, (3,), as ``attitude`` does."""
    cos_p = math.cos(pitch)
    return np.array([math.cos(yaw) * cos_p, math.sin(yaw) * cos_p, math.sin(pitch)])


def mounting(axis: float) -> FloatArray:
    """Return the rotation from frame S to frame R.

    ``axis`` is the elevation of the z axis of S: π/2 is up, 0 ahead, -π/2 down [rad].
    """
    cos, sin = math.cos(axis), math.sin(axis)
    return np.array([[sin, 0.0, cos], [0.0, 1.0, 0.0], [-cos, 0.0, sin]])
