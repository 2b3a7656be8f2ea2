"""Values that pass between a learner and its workers: requests, rollouts and single steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import StateGroups
from flipperctl.rollout.episode import Row

Weights = Mapping[str, NDArray[Any]]
"""A network's ``state_dict`` as arrays."""
PlayHere = Callable[[int], Row]
"""Plays the greedy episode of a seed in this process."""
Stop = Callable[[], bool]
"""Returns whether the user has asked the run to stop."""
POLL = 0.1
"""Longest time between two calls of ``Stop`` during a wait for workers [s]."""


@dataclass(frozen=True)
class Step:
    """One step of an episode; observations are the network's inputs, (frames · (N + 3),)."""

    observation: NDArray[np.float32]
    action: int
    reward: float
    next_observation: NDArray[np.float32]
    ending: Row | None
    """``seed``, ``outcome`` and metrics of the episode after its last step; None before."""
    label: NDArray[np.float32] | None = None
    """The teacher's distribution over actions at ``observation``, (9,), if there is a teacher."""
    groups: StateGroups | None = None
    """After the last step, the states that the teacher valued on the episode's ground."""
    explored: bool = False
    """Whether the action was random."""
    privileged: NDArray[np.float32] | None = None
    """Privileged state at ``observation``, (P,), if the training has them."""
    next_privileged: NDArray[np.float32] | None = None
    """Privileged state at ``next_observation``, (P,)."""


@dataclass(frozen=True)
class RolloutRequest:
    """All that a worker needs to play one training episode."""

    episode: int
    """Number of the episode in the run, from 0."""
    seed: int
    epsilon: float
    """Probability of a random action."""
    decision: int
    """Decisions of the run at the time of the request."""
    version: int
    """Number of updates before the weights; requests of one version share their weights."""
    weights: Weights
    difficulty: float = 1.0
    """Difficulty of the terrain, 0 to 1."""


@dataclass(frozen=True)
class Rollout:
    """An episode of T decisions that a worker played."""

    observations: NDArray[np.float32]
    """Inputs of the network, (T + 1, frames · (N + 3))."""
    actions: NDArray[np.int64]
    """Indices of the actions, (T,)."""
    rewards: NDArray[np.float64]
    """Rewards, (T,)."""
    ending: Row
    """Seed, outcome, metrics and difficulty of the episode."""
    labels: NDArray[np.float32] | None = None
    """The teacher's distributions over actions, (T, 9), if there is a teacher."""
    groups: StateGroups | None = None
    """States of the episode's ground that the teacher valued."""
    explored: NDArray[np.bool_] | None = None
    """Whether each action was random, (T,); None if none was."""
    privileged: NDArray[np.float32] | None = None
    """Privileged states at the observations, (T + 1, P), if the training has them."""

    def steps(self) -> Iterator[Step]:
        """Yield the steps in their order."""
        last = len(self.actions) - 1
        for t, (action, reward) in enumerate(zip(self.actions, self.rewards, strict=True)):
            before, after = self.observations[t], self.observations[t + 1]
            ending = self.ending if t == last else None
            label = None if self.labels is None else self.labels[t]
            yield Step(
                observation=before,
                action=int(action),
                reward=float(reward),
                next_observation=after,
                ending=ending,
                label=label,
                groups=None if ending is None else self.groups,
                explored=self.explored is not None and bool(self.explored[t]),
                privileged=None if self.privileged is None else self.privileged[t],
                next_privileged=None if self.privileged is None else self.privileged[t + 1],
            )
