"""An actor: an environment and a network in a worker, which plays whole episodes on request.

The greedy episodes of a policy that is trained are equal, whichever process plays them: their
network is one of its own on the CPU, since another device, or the learner's arrangement of its
parameters, rounds otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import load_file

from flipperctl import plugins
from flipperctl.agent.frames import input_size
from flipperctl.agent.networks import build_network, naming_network
from flipperctl.agent.risk import RiskNetwork, plain_risk, split_weights
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.controllers import DaggerPolicy, PluginPolicy
from flipperctl.policies.source import controller_policy
from flipperctl.policies.trained import ExploringPolicy, SamplingPolicy, TrainedPolicy
from flipperctl.rollout.episode import RolloutRequest, Row, Step, Weights, play, steps
from flipperctl.rollout.seeds import exploration_rng


class Actor:
    """Plays training episodes with the weights that come with each request."""

    def __init__(self, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """Build the environment and the network of ``config``, a ``TrainConfig`` as plain data."""
        torch.set_num_threads(1)
        plugins.load(plugin_paths)
        self._config = parse(TrainConfig, config)
        self._env = FlipperEnv(config=self._config.environment())
        self._greedy = GreedyPlayer(self._config, self._env)
        self._teacher = teacher_of(self._config)

    def evaluate(self, weights: Weights, seed: int) -> Row:
        """Play the greedy episode of a seed; return its row."""
        self._greedy.load(weights)
        return self._greedy.play(seed)

    def play(self, request: RolloutRequest, weights: Weights) -> list[Step]:
        """Play one episode to its end; equal requests with equal weights give equal episodes."""
        self._greedy.load(weights)
        config = self._config
        rng = exploration_rng(config.seed, request.episode)
        policy = training_policy(
            *(config, self._greedy.module, self._teacher, lambda: request.epsilon),
            temperature=lambda: config.temperature_at(request.decision),
            learns=lambda: request.decision >= config.agent.learning_starts,
            rngs=(rng, rng),
        )
        made = steps(
            *(self._env, policy, request.seed),
            difficulty=request.difficulty,
            frames=config.network.frames,
            privileged=config.learns_privileged_value,
        )
        return list(made)


def teacher_of(config: TrainConfig) -> PluginPolicy | None:
    """Return the teacher's policy, if the training has one that acts."""
    teacher = config.teacher.controller
    if teacher is None:
        return None
    return controller_policy(teacher, config.environment(), "teacher.controller")


def training_policy(
    config: TrainConfig,
    module: torch.nn.Module,
    teacher: PluginPolicy | None,
    epsilon: Callable[[], float],
    *,
    temperature: Callable[[], float],
    learns: Callable[[], bool],
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> SamplingPolicy | ExploringPolicy | DaggerPolicy:
    """Return the policy of training episodes, mixed with the teacher if there is one.

    ``learns``: whether the student has begun to learn, before which a teacher drives. ``rngs`` draw
    the actions and the network's noise.
    """
    frames, agent = config.network.frames, config.agent
    student: SamplingPolicy | ExploringPolicy = (
        SamplingPolicy(module, frames, temperature, rngs[0])
        if agent.is_policy_gradient
        else ExploringPolicy(module, frames, epsilon, *rngs, share=agent.exploring_share)
    )
    if teacher is None:
        return student
    return DaggerPolicy(student, teacher, config.teacher, learns, rngs[0])


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


_actor: Actor
"""The actor of this worker process."""


def create_actor(config: dict[str, Any], plugin_paths: list[str]) -> None:
    """Create the actor of this worker process."""
    global _actor
    _actor = Actor(config, plugin_paths)


def play_request(request: RolloutRequest, weights: Weights | Path) -> list[Step]:
    """Let this process's actor play an episode, with weights that may lie in a file."""
    return _actor.play(request, _loaded(weights))


def play_greedily(seed: int, weights: Weights | Path) -> Row:
    """Let this process's actor play a greedy episode, with weights that may lie in a file."""
    return _actor.evaluate(_loaded(weights), seed)


def _loaded(weights: Weights | Path) -> Weights:
    return load_file(weights) if isinstance(weights, Path) else weights
