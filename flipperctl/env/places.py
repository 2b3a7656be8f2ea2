"""Places of the ground at which a robot can stand."""

from __future__ import annotations

import math

from flipperctl.api import Profile, Robot
from flipperctl.sim.resting import resting

_STRIDE = 0.05
"""Distance between two places that are tried [m]."""
_STEEPEST = math.pi / 4
"""Largest absolute pitch of a robot at a place that the ground chooses [rad]."""

Pose = tuple[float, float]
"""World z [m] and pitch [rad] of the chassis."""


def nearest_rest(
    profile: Profile, robot: Robot, x: float, flippers: tuple[float, float], overturn: float
) -> tuple[float, Pose | None]:
    """Return the place on the obstacle nearest to ``x`` [m] where the robot stands, and its pose.

    ``flippers`` are the angles (front, rear) in frame R [rad]; the pitch is below ``overturn``
    [rad] and at most 45°. The pose is None if there is no such place.
    """
    farthest = max(x - profile.start, profile.end - x)
    for step in range(math.ceil(farthest / _STRIDE) + 1):
        for place in {x + step * _STRIDE: None, x - step * _STRIDE: None}:
            if profile.start <= place <= profile.end:
                pose = resting(profile, robot, place, *flippers, min(overturn, _STEEPEST))
                if pose is not None:
                    return place, pose
    return x, None
