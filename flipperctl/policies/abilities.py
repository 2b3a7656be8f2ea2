"""Optional abilities of policies and controllers.

Collectors and policies that wrap others check for an ability, never for a class. One more ability,
the cost of every action, is part of the public API: ``flipperctl.api.CostPolicy``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import Controller, Perception, Policy, Simulator


@runtime_checkable
class LabellingPolicy(Policy, Protocol):
    """A policy that labels every decision for a student."""

    @property
    def label(self) -> NDArray[np.float32]:
        """Distribution over actions at the last decision, (9,)."""


@runtime_checkable
class TrainingPolicy(Policy, Protocol):
    """A policy that takes random actions beside those that it believes best."""

    @property
    def explored(self) -> bool:
        """Whether the last action was random."""


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
class PolicyUser(Protocol):
    """A controller that uses a policy from a file."""

    @property
    def policy(self) -> str:
        """A run, a checkpoint, an exported file or a shipped policy; empty for none."""

    def starting_from(self, policy: Policy, /) -> Controller:
        """Return the same settings with the loaded policy that the setting ``policy`` names."""
