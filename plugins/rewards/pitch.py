"""R_pitch (paper Eqs. 5 and 6)."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import RewardTerm, Transition, reward


@reward("pitch")
class Pitch(RewardTerm):
    """R_pitch (paper Eq. 6): the chassis swings little, and least of all when it is steep.

    The paper averages over the k decisions that follow; the swing is averaged here over the last
    k pitches, which a reward paid at once can know.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    lambda_2: float = Field(8.0, gt=0, le=1000, description="slope of the penalty [1/rad]")
    window: int = Field(3, ge=2, le=100, description="k, pitches averaged over; paper silent [-]")

    def __call__(self, t: Transition) -> float:
        """In [-1, 0]; -1 where the mean swing exceeds 1/λ2, or beyond π/4 and still rising."""
        rising = abs(t.after.pitch) > abs(t.before.pitch)
        if abs(t.after.pitch) > math.pi / 4 and rising:
            return -1.0
        swing = float(np.abs(np.diff(t.pitches[-self.window :])).mean())
        return -min(1.0, self.lambda_2 * swing)
