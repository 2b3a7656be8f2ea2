"""Reward against pitch variation at 100 Hz."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("swing")
class Swing(RewardTerm):
    """Penalise the sum of the absolute pitch changes within the decision, from poses at 100 Hz.

    Below the cap, the sum over an episode is proportional to its θ̂_R at 100 Hz (the measure
    ``pitch_variation_100hz``). Unlike ``pitch``, the term sees a chassis that rocks and returns
    within a decision.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    slope: float = Field(
        1.0,
        gt=0,
        le=1000,
        description="slope of the penalty; the cap of 1 is reached at 1/slope rad in a decision "
        "[1/rad]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: 0 for a transition without a path."""
        pitch = t.path[:, 2]
        variation = float(np.add.reduce(np.abs(pitch[1:] - pitch[:-1])))  # [rad]
        return -min(1.0, self.slope * variation)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        variation = np.abs(np.diff(ts.path[:, :, 2])).sum(axis=1)  # (M,) [rad]
        penalty: FloatArray = np.minimum(1.0, self.slope * variation)
        return -penalty
