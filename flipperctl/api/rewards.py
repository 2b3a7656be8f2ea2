"""Reward terms, and potential-based shaping, which preserves every optimal policy."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeVar

from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.values import RobotGeometry, RobotState, Transition


class RewardTerm(Plugin, ABC):
    """One summand of the reward; the environment multiplies it by ``weight``."""

    kind: ClassVar[str] = "reward"
    bounds: ClassVar[tuple[float, float]] = (-math.inf, math.inf)
    """Smallest and largest unweighted value; a term at its smallest value counts as saturated."""
    weight: float = Field(1.0, ge=-1e6, le=1e6, description="factor of the term in the sum [-]")

    @abstractmethod
    def __call__(self, t: Transition) -> float:
        """Return the unweighted reward of one decision [-]."""


class Shaping(RewardTerm):
    """Potential-based shaping: γ·Φ(after) − Φ(before), with Φ = 0 after every outcome.

    It leaves every optimal policy optimal (Ng, Harada and Russell 1999): over a whole episode the
    discounted terms add up to −Φ(start), whichever actions were taken. This holds only for the
    discount ``gamma``, and only if no outcome is bootstrapped; training checks both conditions. A
    subclass implements ``potential``, and ``bounds`` if Φ is bounded.
    """

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )

    @abstractmethod
    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Return the potential Φ of a state, a function of the state alone [-]."""

    def __call__(self, t: Transition) -> float:
        """Return the unweighted shaping of one decision [-]."""
        after = 0.0 if t.outcome is not None else self.potential(t.after, t.profile, t.robot)
        return self.gamma * after - self.potential(t.before, t.profile, t.robot)


RewardT = TypeVar("RewardT", bound=RewardTerm)


def reward(name: str) -> Callable[[type[RewardT]], type[RewardT]]:
    """Register a ``RewardTerm``; add it with ``+reward@rewards.<term>=<name>``."""
    return register(RewardTerm, name)
