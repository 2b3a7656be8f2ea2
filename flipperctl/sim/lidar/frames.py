"""Rotations of the simulated robot: to the engine's world and to a level frame.

In: the true state. Out: rotation matrices, (3, 3). They differ where the engine tilts gravity in
place of the ground: world's z axis is then not vertical, and roll and pitch are against gravity.
"""

from __future__ import annotations

import math

import numpy as np

from flipperctl.api import FloatArray, RobotState
from flipperctl.core.lidar.rotations import attitude

_VERTICAL = 1e-12
"""Difference of 1 and the z part of the vertical up to which world's z axis is vertical [-]."""


def to_world(state: RobotState) -> FloatArray:
    """Return the rotation from frame R to world."""
    if state.orientation is not None:
        return state.orientation
    return attitude(state.roll, state.pitch, state.yaw)


def upwards(state: RobotState) -> FloatArray:
    """Return the direction against gravity in frame R, (3,)."""
    x, y = math.sin(state.pitch), math.sin(state.roll)
    z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
    return np.array([x, y, math.copysign(z, math.cos(state.pitch))])


def heading(state: RobotState) -> float:
    """Return the heading of a level frame [rad]: about the vertical, and not about world's z."""
    if state.orientation is None:
        return state.yaw
    level = levelled(state)
    if level[2, 2] > 1.0 - _VERTICAL:
        return state.yaw
    ahead = level @ state.orientation[:, 0]
    return math.atan2(ahead[1], ahead[0])


def levelled(state: RobotState) -> FloatArray:
    """Return the rotation from world to level axes, the first of which is below or above world's x.

    It is the same during an episode.
    """
    if state.orientation is None:
        return np.eye(3)
    up = state.orientation @ upwards(state)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    return np.array([ahead, np.cross(up, ahead), up])
