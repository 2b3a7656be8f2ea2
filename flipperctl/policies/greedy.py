"""``greedy``: the policy of a file that always takes the action with the largest Q-value.

In: a file with Q-values. Out: actions, and the negated Q-values as costs, by which a policy can
teach another one, such as a smaller network.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field, PrivateAttr

from flipperctl.api import Controller, FloatArray, Perception, Policy, Simulator, controller
from flipperctl.errors import ConfigError
from flipperctl.policies.abilities import ValuedPolicy


@controller("greedy")
class Greedy(Controller):
    """Drive by the Q-values of a policy's file alone, without drawing actions when it warns.

    The costs of its actions are the negated Q-values, so that it can teach: with
    ``teacher.temperature`` equal to the ``teacher.q_temperature`` of its own training, the labels
    are the probabilities that it learnt.
    """

    policy: str = Field(
        "generalist",
        description="a run, a checkpoint, an exported file or a shipped policy that drives [-]",
    )

    _trained: Policy | None = PrivateAttr(None)

    def starting_from(self, policy: Policy) -> Greedy:
        """Return these settings with the loaded policy that ``policy`` names."""
        settings = self.model_copy()
        settings._trained = policy
        return settings

    def build(self) -> Policy:
        """Return a policy that acts by the Q-values.

        Raises:
            ConfigError: no policy is named, or it was not loaded, or it has no Q-values.
        """
        if not isinstance(self._trained, ValuedPolicy):
            raise ConfigError(
                f"policy: {self.policy!r} is no policy of a file that this command reads; the name "
                "of a run, a checkpoint, an exported file or a shipped policy is allowed"
            )
        return GreedyPolicy(self._trained)


class GreedyPolicy:
    """Acts by the Q-values of another policy."""

    def __init__(self, valued: ValuedPolicy) -> None:
        self._valued = valued

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""

    def act(self, p: Perception) -> int:
        """Return the index of the action with the largest Q-value."""
        return int(self.costs(p).argmin())

    def costs(self, p: Perception) -> FloatArray:
        """Return the negated Q-values, (9,) [-]."""
        return -np.asarray(self._valued.q_values(p), np.float64)

    def took(self, action: int) -> None:
        """Do nothing: the next costs do not depend on it."""

    def follow(self, p: Perception, action: int) -> None:
        """Do nothing: the next costs do not depend on it."""
