"""Reward for smooth actions."""

from typing import ClassVar

import numpy as np

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("smoothness")
class Smoothness(RewardTerm):
    """Penalise the change from the previous action; stopping costs half as much as reversing.

    This is the first-order temporal smoothness of Mysore et al. 2021 ("Regularizing Action Policies
    for Smooth Control with Reinforcement Learning"), as a reward.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: -1 if both pairs reverse."""
        pairs = zip(t.action, t.previous_action, strict=True)
        return -sum(abs(now - before) for now, before in pairs) / 4

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        change = np.abs(ts.action - ts.previous_action)  # (M, 2)
        penalty: FloatArray = change.sum(axis=1) / 4
        return -penalty
