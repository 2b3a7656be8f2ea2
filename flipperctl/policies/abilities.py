"""What policies of files can do beside acting, and controllers that use such policies.

The cost of every action is part of the public API: ``flipperctl.api.CostPolicy``. What else a
policy tells is an attribute that others lack: ``label`` and ``groups`` for a student, ``explored``
and ``risk``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import Controller, Perception, Policy, Simulator


class FilePolicy(Protocol):
    """A policy of a file, which acts by a Q-value of each action, on observations alone."""

    def reset(self, simulator: Simulator | None = None, /) -> None:
        """Begin an episode; no simulator is needed."""

    def act(self, p: Perception, /) -> int:
        """Return the index into ``ACTIONS`` of the next action."""

    def act_on(self, recent: Sequence[NDArray[np.float32]], /) -> int:
        """Return the next action after these observations, each (N + 3,) in SI units.

        They are the newest of the episode, the last one is new to the policy.
        """

    def q_values(self, p: Perception, /) -> Sequence[float]:
        """Return the Q-values, (9,), without changing what the policy remembers."""


@runtime_checkable
class PolicyUser(Protocol):
    """A controller that uses policies of files."""

    @property
    def named(self) -> Mapping[str, str]:
        """Runs, checkpoints, exported files or shipped policies, by the settings that name them.

        A key is a field, or an entry of one that holds several: ``policy``, ``others[0]``.
        """

    def starting_from(self, policies: Sequence[Policy], /) -> Controller:
        """Return the same settings with the loaded policies, in the order of ``named``."""
