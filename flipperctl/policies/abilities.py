"""Optional abilities of policies and controllers.

Collectors and policies that wrap others check for an ability, never for a class. One more ability,
the cost of every action, is part of the public API: ``flipperctl.api.CostPolicy``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    Controller,
    CostPolicy,
    Perception,
    Policy,
    Simulator,
    StateGroups,
)
from flipperctl.core.risk import RiskSign


@runtime_checkable
class LabellingPolicy(Policy, Protocol):
    """A policy that labels every decision for a student."""

    @property
    def label(self) -> NDArray[np.float32]:
        """Distribution over actions at the last decision, (9,)."""

    @property
    def groups(self) -> StateGroups | None:
        """States of the episode's ground with their values; None if they are not known."""


@runtime_checkable
class FollowingPolicy(CostPolicy, Protocol):
    """A teacher that labels single decisions of others, since it can follow the rest."""

    def follow(self, p: Perception, action: int, /) -> None:
        """Receive a decision without being asked for its costs."""


@runtime_checkable
class TrainingPolicy(Policy, Protocol):
    """A policy that takes random actions beside those that it believes best."""

    @property
    def explored(self) -> bool:
        """Whether the last action was random."""


@runtime_checkable
class RiskPolicy(Policy, Protocol):
    """A policy that may tell how likely the episode is about to fail."""

    @property
    def risk(self) -> float | None:
        """Risk at the last decision, 0 to 1; None if the policy knows none."""

    @property
    def risk_sign(self) -> RiskSign | None:
        """When a risk is a warning; None if the policy knows no risk."""


@runtime_checkable
class ObservationPolicy(Protocol):
    """A policy that acts on observations alone, as those of files do."""

    def reset(self, simulator: Simulator | None = None, /) -> None:
        """Begin an episode; no simulator is needed."""

    def act(self, p: Perception, /) -> int:
        """Return the index into ``ACTIONS`` of the next action."""

    def act_on(self, recent: Sequence[NDArray[np.float32]], /) -> int:
        """Return the next action after these observations, each (N + 3,) in SI units.

        They are the newest of the episode, the last one is new to the policy.
        """


@runtime_checkable
class ValuedPolicy(Policy, Protocol):
    """A policy that acts by a Q-value of each action."""

    def q_values(self, p: Perception, /) -> Sequence[float]:
        """Return the Q-values, (9,), without changing what the policy remembers."""


@runtime_checkable
class ValuingPolicy(Policy, Protocol):
    """A policy that knows the values of states beside its way."""

    def groups(self, rng: np.random.Generator, /) -> StateGroups:
        """Return groups of states of the episode's ground with the values of their actions."""


@runtime_checkable
class PolicyUser(Protocol):
    """A controller that uses policies from files."""

    @property
    def named(self) -> Mapping[str, str]:
        """Runs, checkpoints, exported files or shipped policies, by the settings that name them.

        A key is a field, or an entry of one that holds several: ``policy``, ``others[0]``.
        """

    def starting_from(self, policies: Sequence[Policy], /) -> Controller:
        """Return the same settings with the loaded policies, in the order of ``named``."""
