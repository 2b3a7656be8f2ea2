"""Reward for progress along the track."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("progress")
class Progress(RewardTerm):
    """Reward the distance that the chassis moves forward; penalise moving back equally.

    Below the cap, the sum over a crossing is proportional to its length and does not depend on the
    speed: up to 0.33 m/s with decisions of 0.6 s. This term changes which policy is optimal;
    ``shaped_progress`` does not.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    distance: float = Field(
        0.2,
        gt=0.01,
        le=10,
        description="distance per decision at which the reward reaches its maximum, 1 [m]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 1]."""
        moved = float(t.after.position[0] - t.before.position[0])  # [m]
        return max(-1.0, min(1.0, moved / self.distance))

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        moved = ts.after.position[:, 0] - ts.before.position[:, 0]  # [m]
        return np.clip(moved / self.distance, -1.0, 1.0)
