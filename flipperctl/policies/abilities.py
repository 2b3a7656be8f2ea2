"""Optional abilities of policies and controllers.

Collectors and policies that wrap others check for an ability, never for a class. One more ability,
the cost of every action, is part of the public API: ``flipperctl.api.CostPolicy``.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import Controller, Policy


@runtime_checkable
class LabellingPolicy(Policy, Protocol):
    """A policy that labels every decision for a student."""

    @property
    def label(self) -> NDArray[np.float32]:
        """Distribution over actions at the last decision, (9,)."""


@runtime_checkable
class PolicyUser(Protocol):
    """A controller that uses a policy from a file."""

    @property
    def policy(self) -> str:
        """A run, a checkpoint, an exported file or a shipped policy; empty for none."""

    def starting_from(self, policy: Policy, /) -> Controller:
        """Return the same settings with the loaded policy that the setting ``policy`` names."""
