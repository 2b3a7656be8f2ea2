"""Where the LiDAR is on the robot, and which of its points are of the ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.messages import Joints
from flipperctl.core.lidar.rotations import mounting


@dataclass(frozen=True)
class Mount:
    """Where the LiDAR is on the robot, and which of its points count."""

    x: float
    """Position ahead of the chassis centre, along the chassis [m]."""
    z: float
    """Height above the chassis centre [m]."""
    axis: float
    """Elevation of the axis of its rings [rad]."""
    near: float
    """Points closer than this to the LiDAR are dropped [m]."""
    margin: float
    """Points closer than this to the robot's own shape are dropped [m]."""

    @cached_property
    def position(self) -> FloatArray:
        """Position of the LiDAR, (3,) in frame R [m]."""
        return np.array([self.x, 0.0, self.z])

    @property
    def tells_rays(self) -> bool:
        """Whether rays begin there; clouds in frame R do not tell where theirs do."""
        return bool(self.position.any())

    @cached_property
    def turn(self) -> FloatArray:
        """Rotation from the LiDAR's frame to frame R, (3, 3)."""
        return mounting(self.axis)

    def ground_points(
        self, points: FloatArray, kept: NDArray[np.bool_], body: Body, joints: Joints
    ) -> FloatArray:
        """Return those of the ``kept`` points that are not the robot's own, (P, 3) in frame R [m].

        ``points`` (N, 3) are in the LiDAR's frame [m]. ``kept`` (N,) is changed to which of them
        are returned.
        """
        points = points.compress(kept, axis=0)
        x, y, z = points.T
        far = x * x + y * y + z * z >= self.near**2
        kept[kept] = far
        points = self.position + points.compress(far, axis=0) @ self.turn.T
        others = ~body.contains(points, joints.front, joints.rear, self.margin)
        kept[kept] = others
        return points.compress(others, axis=0)
