"""``value_iteration``: registers the policy that knows the ground, for any reward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field, PrivateAttr

from flipperctl.api import Controller, Policy, RewardTerm, controller
from flipperctl.errors import ConfigError


@controller("value_iteration")
class ValueIteration(Controller):
    """Compute the value of every reachable state of the true ground, then act by it.

    Before an episode, the prediction model explores all flipper settings along the whole ground,
    and value iteration on the states found gives the best return of the configured rewards from
    each. It takes one to three seconds. The policy is a yardstick for others and, as a teacher
    (``teacher=searched``), their source of values; it cannot run on a robot.
    """

    searches_first: ClassVar[bool] = False  # it decides in any state, whoever led there
    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")
    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )
    step: float = Field(0.02, ge=0.005, le=0.04, description="time step of the prediction [s]")
    iterations: int = Field(8, ge=1, le=40, description="solver iterations per step [-]")
    friction: float = Field(
        0.9,
        gt=0,
        le=10,
        description="friction in the prediction if the episode's own is not known [-]",
    )
    groups: int = Field(
        96,
        ge=1,
        le=10_000,
        description="groups of states of each ground that a student learns from [-]",
    )
    off_path: float = Field(
        0.4,
        ge=0,
        le=1,
        description="fraction of the groups around states that any flipper setting may reach; the "
        "others lie around states near the best way [-]",
    )

    _rewards: Mapping[str, RewardTerm] | None = PrivateAttr(None)

    def paying(self, rewards: Mapping[str, RewardTerm]) -> ValueIteration:
        """Return these settings with the reward terms that count."""
        settings = self.model_copy()
        settings._rewards = rewards
        return settings

    def build(self) -> Policy:
        """Return a policy that explores the ground at the start of each episode.

        Raises:
            ConfigError: no reward terms were given, or a term needs what predictions lack.
        """
        from flipperctl.lookahead.oracle import OraclePolicy

        if not self._rewards:
            raise ConfigError(
                "controller=value_iteration: there are no rewards to compute values of"
            )
        return OraclePolicy(self, self._rewards)
