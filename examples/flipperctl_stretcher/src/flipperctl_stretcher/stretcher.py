"""A reward term for flipperctl: ``+reward@rewards.stretcher=stretcher``."""

import math
from typing import ClassVar

from pydantic import Field

from flipperctl.api import RewardTerm, Transition, reward


@reward("stretcher")
class Stretcher(RewardTerm):
    """Whoever lies on the robot's back is carried level: tilt beyond what is comfortable costs."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    comfortable: float = Field(
        math.radians(10), ge=0, le=1, description="pitch, either way, that costs nothing [rad]"
    )
    unbearable: float = Field(
        math.radians(35), gt=0, le=1.5, description="pitch beyond which nothing costs more [rad]"
    )

    def __call__(self, t: Transition) -> float:
        """In [-1, 0]; the square of the way from comfortable to unbearable."""
        beyond = abs(t.after.pitch) - self.comfortable
        width = max(self.unbearable - self.comfortable, 1e-6)  # [rad]
        return -(min(1.0, max(0.0, beyond / width)) ** 2)
