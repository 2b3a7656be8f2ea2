"""How high a chassis may be at the finish, for searches that know the true ground."""

from __future__ import annotations

import math

from flipperctl.api import Profile, RobotGeometry
from flipperctl.config import Episode

_CLEARANCE = Episode().clearance
"""Largest height of the chassis' higher end above the ground at the finish [m].

A ``Simulator`` does not tell its episode's own ``clearance``, so plans aim at the default; the
episode decides whether a trajectory has reached the finish."""


def highest_at_finish(profile: Profile, robot: RobotGeometry, finish: float) -> float:
    """Return the largest world z of the chassis' higher end at the ``finish``, world x [m].

    It is infinite where the ground goes on, on a slope or a stair; the episode compares the chassis
    with a resting one there.
    """
    if finish < profile.end:
        return math.inf
    return profile.height(finish) + robot.track_radius + _CLEARANCE
