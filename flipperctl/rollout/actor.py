"""What runs in a worker: an environment and a network that plays whole episodes on request."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from flipperctl import plugins
from flipperctl.agent.building import build_network, module_fault
from flipperctl.agent.frames import stacked
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.policies.exploring import ExploringPolicy
from flipperctl.policies.trained import QPolicy
from flipperctl.rollout.episode import Row, decisions, play
from flipperctl.rollout.seeds import exploration
from flipperctl.rollout.values import Rollout, RolloutRequest, Weights


class Actor:
    """Plays episodes of training with the weights that come with each request."""

    def __init__(self, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """``config``: the container of a ``TrainConfig``."""
        torch.set_num_threads(1)
        plugins.load(plugin_paths)
        settings = parse(TrainConfig, config)
        self._env = FlipperEnv(config=settings.environment())
        self._module = build_network(settings.network, self._env.layout, len(ACTIONS))
        self._module.requires_grad_(False)
        self._frames = settings.network.frames
        self._seed = settings.seed

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Row]:
        """Play an episode of each seed greedily."""
        self._load(weights)
        policy = QPolicy(self._module.eval(), self._frames)
        return [play(self._env, policy, seed) for seed in seeds]

    def play(self, request: RolloutRequest, weights: Weights) -> Rollout:
        """Play one episode to its end; equal requests give equal episodes.

        The weights come apart from the request, since many requests share them.
        """
        self._load(weights)
        self._module.train()
        rng = exploration(self._seed, request.episode)
        policy = ExploringPolicy(self._module, self._frames, lambda: request.epsilon, rng, rng)
        played = list(decisions(self._env, policy, request.seed, difficulty=request.difficulty))
        seen = [stacked(played[0].perception.recent, self._frames)]
        seen += [stacked(d.next_perception.recent, self._frames) for d in played]
        ending = {**(played[-1].ending or {}), "difficulty": request.difficulty}
        actions = np.array([d.action for d in played])
        return Rollout(np.array(seen), actions, np.array([d.reward for d in played]), ending)

    def _load(self, weights: Weights) -> None:
        state = {name: torch.from_numpy(array) for name, array in weights.items()}
        try:
            self._module.load_state_dict(state)
        except BaseException as error:  # a module that changed its shapes, say
            raise module_fault(error, self._module, "load_state_dict") from error


class StartedActor:
    """An actor, or why there is none: told with each answer, since a start has nobody to tell."""

    def __init__(self, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """As ``Actor``; raises nothing of flipperctl's own."""
        self._actor: Actor | FlipperctlError
        try:
            self._actor = Actor(config, plugin_paths)
        except FlipperctlError as error:
            self._actor = error

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Row]:
        """As ``Actor.evaluate``."""
        return self._ready().evaluate(weights, seeds)

    def play(self, request: RolloutRequest, weights: Weights) -> Rollout:
        """As ``Actor.play``."""
        return self._ready().play(request, weights)

    def _ready(self) -> Actor:
        if isinstance(self._actor, FlipperctlError):
            raise self._actor
        return self._actor
