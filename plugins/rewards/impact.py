"""Reward against impacts."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import RewardTerm, Transition, reward


@reward("impact")
class Impact(RewardTerm):
    """Penalise the largest vertical acceleration of the chassis' centre during the decision.

    The acceleration is the difference at 100 Hz of the vertical velocity: that before the decision,
    the mean over each sample period, and that after the decision. Thus no impact falls between two
    decisions.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    tolerance: float = Field(5.0, ge=0, le=1000, description="acceleration without penalty [m/s²]")
    worst: float = Field(
        30.0, gt=0, le=10_000, description="excess over the tolerance that costs 1 [m/s²]"
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: 0 for a transition without a path."""
        if len(t.path) < 2:
            return 0.0
        rise = np.diff(t.path[:, 1]) / t.sample_period  # (S,) [m/s]
        velocity = np.concatenate([t.before.velocity[1:], rise, t.after.velocity[1:]])
        peak = float(np.abs(np.diff(velocity)).max()) / t.sample_period
        return -min(1.0, max(0.0, peak - self.tolerance) / self.worst)
