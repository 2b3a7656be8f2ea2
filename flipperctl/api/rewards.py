"""Reward terms, and potential-based shaping, which preserves every optimal policy.

A term is a function of one decision; an array form, for speed, computes many at once.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import numpy as np
from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.transitions import RobotStates, Transitions
from flipperctl.api.values import RobotGeometry, RobotState, Transition
from flipperctl.core.arrays import FloatArray


def _renew(cls: type, one: str, many: str, default: Callable[..., object]) -> None:
    """Replace an inherited array form, which may differ from the method that a class overrides."""
    if one in vars(cls) and many not in vars(cls):
        setattr(cls, many, default)


class RewardTerm(Plugin, ABC):
    """One summand of the reward; the environment multiplies it by ``weight``."""

    kind: ClassVar[str] = "reward"
    bounds: ClassVar[tuple[float, float]] = (-math.inf, math.inf)
    """Smallest and largest unweighted value; a term at its smallest value counts as saturated."""
    not_predicted: ClassVar[str] = ""
    """What the term needs and a prediction lacks, as in "the last edge"; empty: nothing. A property
    where it depends on the term's settings.

    A search predicts decisions on the ground that is perceived. It knows states, poses, actions and
    the outcome there, but neither the ground beyond, hence not the last edge (``profile.end``) or
    the finish, nor forces. Potential-based shaping then takes the last perceived edge for the last.
    """
    weight: float = Field(1.0, ge=-1e6, le=1e6, description="factor of the term in the sum [-]")

    @abstractmethod
    def __call__(self, t: Transition) -> float:
        """Return the unweighted reward of one decision [-]."""

    def __init_subclass__(cls, **given: Any) -> None:
        """Give a class that computes one decision anew the array form that calls it."""
        super().__init_subclass__(**given)
        _renew(cls, "__call__", "array", RewardTerm.array)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the unweighted rewards of M decisions, (M,) [-].

        This calls the term for each decision. A term may override it for speed, with equal values.
        """
        return np.array([self(t) for t in ts], dtype=np.float64)


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

    def __init_subclass__(cls, **given: Any) -> None:
        """Give a class that computes one potential anew the array form that calls it."""
        super().__init_subclass__(**given)
        _renew(cls, "potential", "potentials", Shaping.potentials)

    def potentials(self, states: RobotStates, profile: Profile, robot: RobotGeometry) -> FloatArray:
        """Return the potentials Φ of M states, (M,) [-]; may be overridden for speed."""
        return np.array([self.potential(s, profile, robot) for s in states], dtype=np.float64)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the unweighted shaping of M decisions, (M,) [-]."""
        after = np.where(ts.ended, 0.0, self.potentials(ts.after, ts.profile, ts.robot))
        return self.gamma * after - self.potentials(ts.before, ts.profile, ts.robot)


RewardT = TypeVar("RewardT", bound=RewardTerm)


def reward(name: str) -> Callable[[type[RewardT]], type[RewardT]]:
    """Register a ``RewardTerm``; add it with ``+reward@rewards.<term>=<name>``."""
    return register(RewardTerm, name)
