"""The robot: geometry, masses, and the speeds and torques of its actuators."""

from __future__ import annotations

import math
from typing import ClassVar

from pydantic import Field

from flipperctl.api.values import RobotGeometry


class Robot(RobotGeometry):
    """Geometry from the paper, and masses from the laboratory's public robot model."""

    not_sampled: ClassVar[frozenset[str]] = frozenset(
        {"angle_limit", "angle_step", "control_period"}
    )
    chassis_mass: float = Field(35.0, gt=1, le=500, description="chassis with main tracks [kg]")
    flipper_mass: float = Field(5.0, gt=0.1, le=100, description="one pair of flippers [kg]")
    track_speed: float = Field(
        0.2, gt=0, le=2, description="speed of all belts' surfaces along their outline [m/s]"
    )
    flipper_speed: float = Field(
        math.radians(25), gt=0.05, le=5, description="turning rate of a flipper pair [rad/s]"
    )
    flipper_torque: float = Field(
        200.0,
        gt=1,
        le=5000,
        description="largest torque of a flipper pair; not given in the paper [N m]",
    )
    actuator_delay: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="delay of the flippers' turn after a decision; not given in the paper [s]",
    )

    control_period: float | None = Field(
        None,
        gt=0,
        le=10,
        description="time between two decisions; null is angle_step / flipper_speed, in which a "
        "flipper turns by one step [s]",
    )

    @property
    def decision_period(self) -> float:
        """Time between two decisions [s]."""
        if self.control_period is not None:
            return self.control_period
        return self.angle_step / self.flipper_speed
