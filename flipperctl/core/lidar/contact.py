"""How far the robot seems to hover above its map, by which the map's height is corrected.

In: the outline of the tracks and points of the ground. Out: the clearances between both. A robot
touches the ground, so a clearance is an error of the map: a LiDAR's distances are all a bit too
long or too short, and odometry rises or sinks. Without the correction, a rule that lowers a flipper
to the ground that it sees too low lifts the robot with it, and never stops.
"""

from __future__ import annotations

import numpy as np

from flipperctl.core.arrays import FloatArray

_BELOW = 0.7
"""Part of a circle's radius from its middle in which ground counts as below it, since points of a
face beside the track tell nothing about heights [-]."""


def clearances(circles: FloatArray, radius: float, points: FloatArray) -> FloatArray:
    """Return the vertical distance from the tracks down to each point, (P,) [m].

    It is infinite for points that are not below a track, and negative for points within one.
    ``circles`` (C, 2) and ``points`` (P, 2) are in frame L [m].
    """
    across = points[None, :, 0] - circles[:, None, 0]  # (C, P)
    below = np.abs(across) <= _BELOW * radius
    bottom = circles[:, None, 1] - np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    gap: FloatArray = np.where(below, bottom - points[None, :, 1], np.inf)
    return np.asarray(gap.min(axis=0, initial=np.inf))
