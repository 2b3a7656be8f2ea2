"""A training as its learner sees it: ``flipperctl.api.Training`` of a configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from flipperctl.api import Policy, Step
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.rollout.episode import steps

if TYPE_CHECKING:
    import torch


class ConfiguredTraining:
    """The training of a configuration, in one process."""

    def __init__(
        self,
        config: TrainConfig,
        shared: Mapping[str, Any] | None = None,
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        """``shared``: in a worker's process, what the learner's process shares."""
        self.config, self.network, self.actions = config, config.network, config.actions
        self.layout, self.decisions = config.perception.layout, config.train.decisions
        self.device, self.report = config.device, report
        # Streams of the seed: first weights, exploration, samples of the replay, a fit at the end.
        init, explore, sample, _ = np.random.SeedSequence(config.seed).spawn(4)
        self.seed = int(init.generate_state(1)[0])
        self.shared: dict[str, Any] = dict(shared or {})
        self.generators: dict[str, np.random.Generator] = {}
        # A worker's exploration follows from the episode instead (``exploration_rng``).
        if shared is None:
            self.generators["explore"] = np.random.default_rng(explore)
            self.generators["sample"] = np.random.default_rng(sample)

    def policy_network(self) -> torch.nn.Module:
        """Return the policy's network with random first weights, which ``seed`` determines."""
        import torch

        from flipperctl.agent.networks import build_policy

        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            return build_policy(self.network, self.layout, self.actions)

    def environment(self) -> FlipperEnv:
        """Return a new environment of the training."""
        return FlipperEnv(config=self.config.environment(), actions=self.actions)

    def steps(
        self, env: FlipperEnv, policy: Policy, seed: int, difficulty: float
    ) -> Iterator[Step]:
        """Yield the steps of an episode with what the learner asks for."""
        config = self.config
        frames, privileged = config.network.frames, config.agent.privileged(config)
        return steps(env, policy, seed, difficulty=difficulty, frames=frames, privileged=privileged)
