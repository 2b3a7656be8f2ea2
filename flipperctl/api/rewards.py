"""Reward terms, and the shaping that changes no optimal policy."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeVar

from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import Profile, RobotGeometry, RobotState, Transition


class RewardTerm(Plugin, ABC):
    """One summand of the reward; the environment multiplies it by ``weight``."""

    kind: ClassVar[str] = "reward"
    bounds: ClassVar[tuple[float, float]] = (-math.inf, math.inf)
    """Least and largest unweighted value; a term at its least is saturated."""
    weight: float = Field(1.0, ge=-1e6, le=1e6, description="factor of the term in the sum [-]")

    @abstractmethod
    def __call__(self, t: Transition) -> float:
        """The unweighted reward of one decision [-]."""


class Shaping(RewardTerm):
    """Potential-based shaping: γ·Φ(after) − Φ(before), and Φ = 0 behind every outcome.

    It leaves every optimal policy optimal (Ng, Harada and Russell 1999): over a whole episode the
    discounted terms add up to −Φ(start), whatever the robot did in between. That holds for the
    discount ``gamma`` alone, and only if nothing is expected behind an outcome; training checks
    both. A subclass writes ``potential``, and ``bounds`` if Φ has any.
    """

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )

    @abstractmethod
    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Φ, how good it is to be there; a function of the state alone [-]."""

    def __call__(self, t: Transition) -> float:
        """The unweighted shaping of one decision [-]."""
        ahead = 0.0 if t.outcome is not None else self.potential(t.after, t.profile, t.robot)
        return self.gamma * ahead - self.potential(t.before, t.profile, t.robot)


RewardT = TypeVar("RewardT", bound=RewardTerm)


def reward(name: str) -> Callable[[type[RewardT]], type[RewardT]]:
    """Register a ``RewardTerm``; add it with ``+reward@rewards.<term>=<name>``."""
    return register(RewardTerm, name)
