"""Reward against impacts."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("impact")
class Impact(RewardTerm):
    """Penalise the largest vertical acceleration of the chassis' centre during the decision.

    The acceleration is the change of the vertical velocity at 100 Hz: the velocity before the
    decision, its mean over each sample period, and the velocity after the decision. Thus impacts
    between two decisions are seen too.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    tolerance: float = Field(
        5.0, ge=0, le=1000, description="largest acceleration without a penalty [m/s²]"
    )
    worst: float = Field(
        30.0,
        gt=0,
        le=10_000,
        description="excess over the tolerance at which the reward is -1 [m/s²]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: 0 for a transition without a path."""
        if len(t.path) < 2:
            return 0.0
        rise = np.diff(t.path[:, 1]) / t.sample_period  # (S,) [m/s]
        velocity = np.concatenate([t.before.velocity[1:], rise, t.after.velocity[1:]])
        peak = float(np.abs(np.diff(velocity)).max()) / t.sample_period
        return -min(1.0, max(0.0, peak - self.tolerance) / self.worst)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        if ts.path.shape[1] < 2:
            return np.zeros(len(ts))
        rise = np.diff(ts.path[:, :, 1]) / ts.sample_period  # (M, S) [m/s]
        velocity = np.hstack([ts.before.velocity[:, 1:], rise, ts.after.velocity[:, 1:]])
        peak = np.abs(np.diff(velocity)).max(axis=1) / ts.sample_period
        excess: FloatArray = np.clip(peak - self.tolerance, 0.0, self.worst)
        return -excess / self.worst
