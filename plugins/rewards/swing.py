"""Reward against pitch variation at 100 Hz, or at decisions."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("swing")
class Swing(RewardTerm):
    """Penalise the sum of the absolute pitch changes within the decision, from poses at 100 Hz.

    Below the cap, the sum over an episode is proportional to its θ̂_R at 100 Hz (the measure
    ``pitch_variation_100hz``). Unlike ``pitch``, the term sees a chassis that rocks and returns
    within a decision. With ``at_decisions`` it does not, and its sum is proportional to the paper's
    θ̂_R, that at decisions (``pitch_variation``).
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    slope: float = Field(
        1.0,
        gt=0,
        le=1000,
        description="slope of the penalty; the cap of 1 is reached at 1/slope rad in a decision "
        "[1/rad]",
    )
    at_decisions: bool = Field(
        False,
        description="whether only the pitch change from one decision to the next counts [-]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: 0 for a transition without a path."""
        pitch = self._counted(t.path)
        variation = float(np.add.reduce(np.abs(pitch[1:] - pitch[:-1])))  # [rad]
        return -min(1.0, self.slope * variation)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        variation = np.abs(np.diff(self._counted(ts.path))).sum(axis=1)  # (M,) [rad]
        penalty: FloatArray = np.minimum(1.0, self.slope * variation)
        return -penalty

    def _counted(self, path: FloatArray) -> FloatArray:
        """Return the pitches whose changes count, of poses (…, S + 1, 3), [rad]."""
        pitch = path[..., 2]
        last = pitch.shape[-1] - 1
        return pitch[..., :: max(1, last)] if self.at_decisions else pitch
