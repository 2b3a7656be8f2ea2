"""Potential-based shaping by distance."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import (
    FloatArray,
    Profile,
    RobotGeometry,
    RobotState,
    RobotStates,
    Shaping,
    reward,
)


@reward("shaped_progress")
class ShapedProgress(Shaping):
    """Potential-based shaping by the distance to the last edge; changes no optimal policy."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    distance: float = Field(
        10.0,
        gt=0.1,
        le=1000,
        description="distance to the last edge at and beyond which Φ = -1 [m]",
    )

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Return Φ in [-1, 0]: 0 past the last edge, falling linearly with the distance to it."""
        left = profile.end - float(state.position[0])
        return -max(0.0, min(1.0, left / self.distance))

    def potentials(self, states: RobotStates, profile: Profile, robot: RobotGeometry) -> FloatArray:
        """Return Φ of M states, (M,)."""
        left = profile.end - states.position[:, 0]  # (M,) [m]
        return -np.clip(left, 0.0, self.distance) / self.distance
