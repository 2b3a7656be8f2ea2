"""The greedy episodes of a policy that is trained: equal ones, whichever process plays them.

In: weights as arrays. Out: the rows of episodes. The network is one of its own on the CPU, since
another device, or the learner's arrangement of its parameters, rounds otherwise.
"""

from __future__ import annotations

import torch

from flipperctl.agent.building import build_network, naming_network
from flipperctl.agent.frames import input_size
from flipperctl.agent.risk import RiskNetwork, plain_risk, split_weights
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.trained import TrainedPolicy
from flipperctl.rollout.episode import Row, play
from flipperctl.rollout.values import Weights


class GreedyPlayer:
    """A policy network, and that of its risk, whose weights come with each request."""

    def __init__(self, config: TrainConfig, env: FlipperEnv) -> None:
        """``env`` plays the episodes."""
        self._env, self._frames = env, config.network.frames
        self._risk = None
        with torch.random.fork_rng(devices=[]):  # the weights will come
            self.module = build_network(config.network, env.layout, len(ACTIONS))
            if config.agent.risk:
                network = RiskNetwork(input_size(config.network, env.layout))
                self._risk = plain_risk(network, config.agent.risk_horizon)
        self.module.requires_grad_(False)

    def load(self, weights: Weights) -> None:
        """Take the weights of a policy and of its risk."""
        risk, state = split_weights(weights)
        if risk and self._risk is not None:
            self._risk.network.load_state_dict(risk)
        with naming_network(self.module, "load_state_dict"):  # its shapes may have changed
            self.module.load_state_dict(state)

    def play(self, seed: int) -> Row:
        """Play the greedy episode of a seed; return its row."""
        return play(self._env, TrainedPolicy(self.module.eval(), self._frames, self._risk), seed)
