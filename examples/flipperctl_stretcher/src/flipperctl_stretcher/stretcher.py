"""A reward term for flipperctl: ``rewards.stretcher=stretcher``."""

import math
from typing import ClassVar

from pydantic import Field

from flipperctl.api import RewardTerm, Transition, reward


@reward("stretcher")
class Stretcher(RewardTerm):
    """Keep a stretcher on the robot level: penalise pitch beyond a comfortable angle."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    comfortable: float = Field(
        math.radians(10), ge=0, le=1, description="largest pitch, up or down, without penalty [rad]"
    )
    unbearable: float = Field(
        math.radians(35), gt=0, le=1.5, description="pitch from which the penalty is 1 [rad]"
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: minus the square of the excess over the comfortable pitch.

        The excess is relative to the range from comfortable to unbearable.
        """
        beyond = abs(t.after.pitch) - self.comfortable
        width = max(self.unbearable - self.comfortable, 1e-6)  # [rad]
        return -(min(1.0, max(0.0, beyond / width)) ** 2)
