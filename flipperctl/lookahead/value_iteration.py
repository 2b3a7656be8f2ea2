"""``value_iteration``: registers the policy that knows the ground, for any reward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import PrivateAttr

from flipperctl.api import Controller, Policy, RewardTerm, controller
from flipperctl.config import PAPER_REWARDS
from flipperctl.config.resolver import create
from flipperctl.lookahead.value_iteration_settings import ValueIterationSettings


@controller("value_iteration")
class ValueIteration(ValueIterationSettings, Controller):
    """Compute the value of every reachable state of the true ground, then act by it.

    Before an episode, the prediction model explores all flipper settings along the whole ground,
    and value iteration on the states found gives the best return of the configured rewards from
    each. It takes one to three seconds. The policy is a yardstick for others and, as a teacher
    (``teacher=searched``), their source of values; it cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    closed_loop: ClassVar[bool] = True
    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")
    _rewards: Mapping[str, RewardTerm] | None = PrivateAttr(None)

    def paying(self, rewards: Mapping[str, RewardTerm]) -> ValueIteration:
        """Return these settings with the reward terms that count."""
        settings = self.model_copy()
        settings._rewards = rewards
        return settings

    def build(self) -> Policy:
        """Return a policy that explores the ground at the start of each episode.

        Without ``paying``, the paper's rewards count.

        Raises:
            ConfigError: a term needs what predictions lack.
        """
        from flipperctl.lookahead.oracle import OraclePolicy

        rewards = self._rewards
        if rewards is None:
            rewards = {n: create("reward", n, f"rewards.{n}") for n in PAPER_REWARDS.values()}
        return OraclePolicy(self, rewards)
