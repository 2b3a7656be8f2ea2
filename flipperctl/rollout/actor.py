"""An actor: an environment and a network in a worker, which plays whole episodes on request.

The greedy episodes of a policy that is trained are equal, whichever process plays them: their
network is one of its own on the CPU, since another device, or the learner's arrangement of its
parameters, rounds otherwise.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flipperctl import plugins
from flipperctl.agent.frames import input_size, stacked
from flipperctl.agent.networks import build_network, naming_network
from flipperctl.agent.risk import RiskNetwork, plain_risk, split_weights
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.privileged import PrivilegedStates
from flipperctl.errors import FlipperctlError
from flipperctl.policies.abilities import LabellingPolicy
from flipperctl.policies.exploring import ExploringPolicy, SamplingPolicy
from flipperctl.policies.source import controller_policy
from flipperctl.policies.teaching import DaggerPolicy
from flipperctl.policies.trained import TrainedPolicy
from flipperctl.rollout.episode import Row, decisions, play
from flipperctl.rollout.seeds import exploration_rng
from flipperctl.rollout.values import Rollout, RolloutRequest, Weights


class Actor:
    """Plays training episodes with the weights that come with each request."""

    def __init__(self, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """Build the environment and the network of ``config``, a ``TrainConfig`` as plain data.

        Raises:
            FlipperctlError: the configuration or a plugin is not valid here.
        """
        torch.set_num_threads(1)
        plugins.load(plugin_paths)
        settings = parse(TrainConfig, config)
        self._env = FlipperEnv(config=settings.environment())
        self._greedy = GreedyPlayer(settings, self._env)
        self._module, self._frames = self._greedy.module, settings.network.frames
        self._seed, self._temperature_at = settings.seed, settings.temperature_at
        self._teaching, self._agent = settings.teacher, settings.agent
        self._privileged = settings.learns_privileged_value
        teacher = settings.teacher.controller
        self._teacher = None
        if teacher is not None:
            environment = settings.environment()
            self._teacher = controller_policy(teacher, environment, "teacher.controller")

    def evaluate(self, weights: Weights, seed: int) -> Row:
        """Play the greedy episode of a seed; return its row."""
        self._greedy.load(weights)
        return self._greedy.play(seed)

    def play(self, request: RolloutRequest, weights: Weights) -> Rollout:
        """Play one episode to its end; equal requests give equal episodes.

        The weights are separate from the request, since many requests share them.
        """
        self._greedy.load(weights)
        rng = exploration_rng(self._seed, request.episode)
        policy = self._driver(request, rng)
        if self._teacher is not None:
            learns = request.decision >= self._agent.learning_starts
            policy = DaggerPolicy(policy, self._teacher, self._teaching, lambda: learns, rng)
        labelling = policy if isinstance(policy, LabellingPolicy) else None
        episode, labels, explored = [], [], []
        privileged = PrivilegedStates(self._env) if self._privileged else None
        for decision in decisions(self._env, policy, request.seed, difficulty=request.difficulty):
            episode.append(decision)
            explored.append(policy.explored)
            if privileged is not None:
                privileged.add(decision.transition)
            if labelling is not None:
                labels.append(labelling.label)
        observations = [stacked(episode[0].perception.recent, self._frames)]
        observations += [stacked(d.next_perception.recent, self._frames) for d in episode]
        ending = {**(episode[-1].ending or {}), "difficulty": request.difficulty}
        actions = np.array([d.action for d in episode])
        rewards = np.array([d.reward for d in episode])
        labelled = np.array(labels) if labels else None
        return Rollout(
            observations=np.array(observations),
            actions=actions,
            rewards=rewards,
            ending=ending,
            labels=labelled,
            groups=None if labelling is None else labelling.groups,
            explored=np.array(explored),
            privileged=None if privileged is None else np.array(privileged.rows),
        )

    def _driver(
        self, request: RolloutRequest, rng: np.random.Generator
    ) -> SamplingPolicy | ExploringPolicy | DaggerPolicy:
        """Return the policy that plays a request, without a teacher."""
        if self._agent.is_policy_gradient:
            temperature = self._temperature_at(request.decision)
            return SamplingPolicy(self._module, self._frames, lambda: temperature, rng)
        return ExploringPolicy(
            *(self._module, self._frames, lambda: request.epsilon, rng, rng),
            share=self._agent.exploring_share,
        )


class StartedActor:
    """An actor whose start-up errors are raised by its first call.

    The start of a worker process cannot return an error to the main process; a call can.
    """

    def __init__(
        self, config: dict[str, Any], plugin_paths: list[str], folder: str | None = None
    ) -> None:
        """Build an ``Actor``; keep a ``FlipperctlError`` for the calls instead of raising it.

        ``folder``: working directory of the learner, to which relative paths in ``config`` refer.
        """
        if folder is not None and Path(folder).is_dir():
            os.chdir(folder)
        self._actor: Actor | FlipperctlError
        try:
            self._actor = Actor(config, plugin_paths)
        except FlipperctlError as error:
            self._actor = error

    def evaluate(self, weights: Weights, seed: int) -> Row:
        """Call ``Actor.evaluate``, or raise the start-up error."""
        return self._ready().evaluate(weights, seed)

    def play(self, request: RolloutRequest, weights: Weights) -> Rollout:
        """Call ``Actor.play``, or raise the start-up error."""
        return self._ready().play(request, weights)

    def _ready(self) -> Actor:
        if isinstance(self._actor, FlipperctlError):
            raise self._actor
        return self._actor


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
