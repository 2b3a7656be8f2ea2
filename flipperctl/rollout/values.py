"""What goes between a learner and those who play for it: requests, rollouts, single steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.rollout.episode import Row

Weights = Mapping[str, NDArray[Any]]
"""A network's ``state_dict`` as arrays."""
EvaluateHere = Callable[[Sequence[int]], list[Row]]
"""Plays an episode of each seed in this process."""
PendingEvaluation = Callable[[], list[Row] | None]
"""Waits for the rows that a worker was asked for; None if it died."""


@dataclass(frozen=True)
class Step:
    """One decision; observations are what the network sees, (frames · (N + 3),)."""

    observation: NDArray[np.float32]
    action: int
    reward: float
    next_observation: NDArray[np.float32]
    ending: Row | None
    """None while the episode runs; else its ``seed``, ``outcome`` and metrics."""


@dataclass(frozen=True)
class RolloutRequest:
    """What a worker needs to play one episode of training."""

    episode: int
    seed: int
    epsilon: float
    """Probability of a random action."""
    decision: int
    """How far the learner was when it made the request."""
    version: int
    """Updates that the weights had seen; requests of one version share them."""
    weights: Weights
    difficulty: float = 1.0
    """Of the terrain, 0 to 1."""


@dataclass(frozen=True)
class Rollout:
    """An episode that a worker played, T decisions long."""

    observations: NDArray[np.float32]
    """(T + 1, frames · (N + 3))"""
    actions: NDArray[np.int64]
    """(T,)"""
    rewards: NDArray[np.float64]
    """(T,)"""
    ending: Row

    def steps(self) -> Iterator[Step]:
        """Yield the decisions in turn."""
        last = len(self.actions) - 1
        for t, (action, reward) in enumerate(zip(self.actions, self.rewards, strict=True)):
            now, following = self.observations[t], self.observations[t + 1]
            ending = self.ending if t == last else None
            yield Step(now, int(action), float(reward), following, ending)
