"""Where the rays of a LiDAR meet the robot that carries it.

In: rays in frame R, which never change, and the angles of the flippers. Out: distances. The chassis
is met at the same places always, and flippers by few of the rays, so neither is computed for all.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.core.lidar.body import Body


class OwnHits:
    """The distances from one place on the robot to its own body along given rays."""

    def __init__(self, body: Body, origin: FloatArray, rays: FloatArray) -> None:
        """``origin`` (3,) [m] and the unit vectors ``rays`` (R, 3) are in frame R."""
        self._body, self._origin = body, origin
        self._to_chassis = body.distances_to_chassis(origin, rays)
        self._near = np.flatnonzero(body.may_hit_flippers(origin, rays))
        self._rays = rays[self._near]

    def distances(self, front: float, rear: float) -> FloatArray:
        """Return the distance to the robot along each ray, (R,), infinite if it misses it [m]."""
        found = self._to_chassis.copy()
        flippers = self._body.distances_to_flippers(self._origin, self._rays, front, rear)
        found[self._near] = np.minimum(found[self._near], flippers)
        return found
