"""Action smoothness."""

from typing import ClassVar

from flipperctl.api import RewardTerm, Transition, reward


@reward("smoothness")
class Smoothness(RewardTerm):
    """How much the action differs from the one before: a pair that stops costs half a reversal.

    The first-order smoothness of actions in time, as in Mysore et al. 2021 ("Regularizing Action
    Policies for Smooth Control with Reinforcement Learning"), here as a reward.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

    def __call__(self, t: Transition) -> float:
        """In [-1, 0]; -1 where both pairs reverse."""
        pairs = zip(t.action, t.previous_action, strict=True)
        return -sum(abs(now - before) for now, before in pairs) / 4
