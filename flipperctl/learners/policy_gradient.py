"""The policy gradient: what goes with it, and who drives its episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from flipperctl.api import Learning, Policy, Training, learner
from flipperctl.config import TrainConfig
from flipperctl.learners.settings import GradientSettings

if TYPE_CHECKING:
    import torch


@learner("policy_gradient")
class PolicyGradient(GradientSettings):
    """Draw actions, and make those more probable that returned more than expected (PPO).

    It is best from the weights of a trained policy, ``agent.start_from``.
    """

    def check_start(self, config: TrainConfig) -> None:
        """Refuse a network, weights or values that cannot be used."""
        from flipperctl.learners.clipped import check_memory, read_values
        from flipperctl.learners.starting import read_start

        check_memory(self, config)
        read_start(config)
        read_values(config)

    def first_update(self, config: Any) -> tuple[int, str]:
        """Return the decisions of the rounds until the policy learns."""
        size = self.round_size(config.train.decisions)
        first = (self.warm_up + 1) * size
        return first, (
            f"it learns from {first} decisions on; {self.warm_up} rounds of "
            f"agent.decisions={size} are for the values alone"
        )

    def build(self, training: Training) -> Learning:
        """Return networks, values and the rounds of episodes."""
        from flipperctl.learners.clipped import GradientLearning

        return GradientLearning(self, training)

    def drive(
        self,
        training: Training,
        module: torch.nn.Module,
        decision: Callable[[], int],
        rng: np.random.Generator,
    ) -> Policy:
        """Return the policy that draws its actions by the Q-values."""
        from flipperctl.policies.acting import SamplingPolicy

        def temperature() -> float:
            return self.temperature_at(decision() / training.decisions)

        frames, joints = training.network.frames, len(training.layout.joints)
        return SamplingPolicy(module, frames, temperature, rng, joints)
