"""The devices, widths and signs of a robot, which the file of a policy does not state.

In: numbers of the builder. Out: frozen settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from flipperctl.core.lidar.mount import Mount
from flipperctl.runtime.signs import OURS, Signs


@dataclass(frozen=True)
class RobotSetup:
    """What the policy's file does not state of the robot: its devices, widths and signs."""

    signs: Signs = OURS
    """The robot's conventions."""
    cloud_frame: str = "lidar"
    """Frame in which clouds must come."""
    attitude_frame: str = "base_link"
    """Frame whose attitude must come: fixed to the chassis, x ahead, y to the left, z up."""
    mount: Mount = field(default_factory=lambda: Mount(0.25, 0.4, -math.pi / 4, 0.1, 0.05))
    """Where the frame of the clouds is on the robot.

    Clouds that come in the frame of the chassis have the mount ``Mount(0, 0, math.pi / 2, …)``.
    """
    chassis_width: float = 0.352
    """Width of the chassis between the flippers [m]."""
    overall_width: float = 0.712
    """Width over the outer sides of the flippers [m]."""
    pose: Literal["belts", "matched"] = "belts"
    """How scans enter the map: by odometry, or corrected by matching (needs small_gicp)."""
    range_bias: float = 0.02
    """Largest constant error of the LiDAR's distances [m]."""
    tilt_error: float = 0.0032
    """Standard deviation of the inertial unit's roll and pitch [rad]."""
