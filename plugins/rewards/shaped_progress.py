"""The way forward as a potential."""

from typing import ClassVar

from pydantic import Field

from flipperctl.api import Profile, RobotGeometry, RobotState, Shaping, reward


@reward("shaped_progress")
class ShapedProgress(Shaping):
    """Potential-based shaping by the distance to the last edge: it guides, and biases nothing."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    distance: float = Field(
        10.0, gt=0.1, le=1000, description="Φ falls to -1 over this, and no further [m]"
    )

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """From 0 behind the last edge to -1."""
        left = profile.end - float(state.position[0])
        return -max(0.0, min(1.0, left / self.distance))
