"""R_pitch (paper Eqs. 5 and 6)."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import LAST_PITCHES, FloatArray, RewardTerm, Transition, Transitions, reward


@reward("pitch")
class Pitch(RewardTerm):
    """R_pitch (paper Eq. 6): penalise pitch variation, most strongly at a steep pitch.

    The paper averages the variation over the next k decisions. Here it is averaged over the last k
    pitches, which are known when the reward is computed.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    lambda_2: float = Field(8.0, gt=0, le=1000, description="slope of the penalty [1/rad]")
    window: int = Field(
        3, ge=2, le=100, description="k, number of last pitches; not given in the paper [-]"
    )

    @property
    def not_predicted(self) -> str:  # type: ignore[override]  # by the window
        """What a search lacks: pitches of longer ago than it carries."""
        if self.window <= LAST_PITCHES:
            return ""
        return f"a window of {self.window} pitches; {LAST_PITCHES} are known"

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0].

        It is -1 if the mean variation exceeds 1/λ2, or if the pitch is beyond ±π/4 and growing.
        """
        rising = abs(t.after.pitch) > abs(t.before.pitch)
        if abs(t.after.pitch) > math.pi / 4 and rising:
            return -1.0
        pitches = t.pitches[-self.window :]
        changes = np.abs(pitches[1:] - pitches[:-1])
        variation = float(np.add.reduce(changes)) / len(changes)  # faster than numpy's mean
        return -min(1.0, self.lambda_2 * variation)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        steep = np.abs(ts.after.pitch)
        growing = (steep > math.pi / 4) & (steep > np.abs(ts.before.pitch))
        variation = np.abs(np.diff(ts.pitches[:, -self.window :])).mean(axis=1)
        return np.where(growing, -1.0, -np.minimum(1.0, self.lambda_2 * variation))
