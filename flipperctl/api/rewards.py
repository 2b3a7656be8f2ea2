"""Reward terms, and potential-based shaping, which preserves every optimal policy.

A term is written once: as ``__call__`` of one decision, or as ``array`` of many. The other form is
derived.
"""

from __future__ import annotations

import inspect
import math
from abc import ABC
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import numpy as np
from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.transitions import RobotStates, Transitions
from flipperctl.api.values import RobotGeometry, RobotState, Transition
from flipperctl.core import FloatArray


def _renew(cls: type, forms: dict[str, Callable[..., object]]) -> None:
    """Derive the form that a class does not write, lest an inherited one differs from its own."""
    if written := forms.keys() & vars(cls):
        for name in forms.keys() - written:
            setattr(cls, name, forms[name])


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
    elementwise: ClassVar[bool] = False
    """Whether ``__call__`` takes ``Transitions`` as well and returns (M,), as formulas do that
    index arrays from their last axis: ``t.after.position[..., 0]``. Searches are then many times
    faster.
    """
    weight: float = Field(1.0, ge=-1e6, le=1e6, description="factor of the term in the sum [-]")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Derive the form of the term that the class does not write."""
        super().__init_subclass__(**kwargs)
        _renew(cls, {"__call__": RewardTerm.__call__, "array": RewardTerm.array})

    def __call__(self, t: Transition) -> float:
        """Return the unweighted reward of one decision [-]."""
        return float(self.array(Transitions.of([t]))[0])

    def array(self, ts: Transitions) -> FloatArray:
        """Return the unweighted rewards of M decisions, (M,) [-]."""
        each: Any = self
        return each(ts) if self.elementwise else np.array([self(t) for t in ts], np.float64)


class Shaping(RewardTerm):
    """Potential-based shaping: γ·Φ(after) − Φ(before), with Φ = 0 after every outcome.

    It leaves every optimal policy optimal (Ng, Harada and Russell 1999): over a whole episode the
    discounted terms add up to −Φ(start), whichever actions were taken. This holds only for the
    discount ``gamma``, and only if no outcome is bootstrapped; training checks both conditions. A
    subclass implements ``potential`` or, of many, ``potentials``, and ``bounds`` if Φ is bounded.
    """

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Return the potential Φ of a state, a function of the state alone [-].

        An ``elementwise`` one takes ``RobotStates`` as well and returns (M,).
        """
        return float(self.potentials(RobotStates.of([state]), profile, robot)[0])

    def __call__(self, t: Transition) -> float:
        """Return the unweighted shaping of one decision [-]."""
        # Φ is 0 after every outcome, else the sum over an episode would not telescope.
        after = 0.0 if t.outcome is not None else self.potential(t.after, t.profile, t.robot)
        return self.gamma * after - self.potential(t.before, t.profile, t.robot)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Derive the form of the potential that the class does not write."""
        super().__init_subclass__(**kwargs)
        _renew(cls, {"potential": Shaping.potential, "potentials": Shaping.potentials})

    def potentials(self, states: RobotStates, profile: Profile, robot: RobotGeometry) -> FloatArray:
        """Return the potentials Φ of M states, (M,) [-]."""
        of: Any = self.potential
        if self.elementwise:
            rewards: FloatArray = of(states, profile, robot)
            return rewards
        return np.array([of(s, profile, robot) for s in states], np.float64)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the unweighted shaping of M decisions, (M,) [-]."""
        after = np.where(ts.ended, 0.0, self.potentials(ts.after, ts.profile, ts.robot))
        return self.gamma * after - self.potentials(ts.before, ts.profile, ts.robot)


RewardT = TypeVar("RewardT", bound=RewardTerm)


def reward(name: str) -> Callable[[type[RewardT]], type[RewardT]]:
    """Register a ``RewardTerm``; add it with ``rewards.<term>=<name>``.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not a ``RewardTerm``, or writes no form of the reward.
    """
    return register(RewardTerm, name, _check_forms)


def _check_forms(cls: type[RewardTerm], where: str) -> None:
    base: type[RewardTerm] = Shaping if issubclass(cls, Shaping) else RewardTerm
    forms = ("potential", "potentials") if base is Shaping else ("__call__", "array")
    if not any(writes(cls, base, form) for form in forms):
        raise TypeError(
            f"{where}: {cls.__name__} needs a method {forms[0]} of one decision, or {forms[1]} of "
            "many"
        )


def limited(value: Any, low: float, high: float) -> float:
    """Return a number within ``low`` and ``high``, or an array (M,) likewise; NaN is kept."""
    is_one = isinstance(value, float)
    clipped: float = min(max(value, low), high) if is_one else np.clip(value, low, high)
    return clipped


def writes(cls: type[RewardTerm], base: type[RewardTerm], form: str) -> bool:
    """Return whether the class implements a form itself; the core may have guarded it."""
    return inspect.unwrap(getattr(cls, form)) is not inspect.unwrap(getattr(base, form))
