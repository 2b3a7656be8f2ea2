"""What passes between a learner and those that play for it: requests, weights and steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.api import Policy, StateGroups
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.privileged import PrivilegedStates
from flipperctl.rollout.episode import Row, decisions

Weights = Mapping[str, NDArray[Any]]
"""A network's ``state_dict`` as arrays."""


@dataclass(frozen=True)
class Step:
    """One step of an episode; observations are the network's inputs, (frames · (N + 3),)."""

    observation: NDArray[np.float32]
    action: int
    reward: float
    next_observation: NDArray[np.float32]
    ending: Row | None
    """``seed``, ``outcome``, metrics and difficulty after the episode's last step; None before."""
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


def steps(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    difficulty: float = 1.0,
    frames: int = 1,
    privileged: bool = False,
) -> Iterator[Step]:
    """Yield the steps of one episode; each is made on request of the iterator.

    ``frames``: number of observations that the network takes as one input. ``privileged``: whether
    the steps have privileged states.
    """
    states = PrivilegedStates(env) if privileged else None
    before: NDArray[np.float32] | None = None
    for d in decisions(env, policy, seed, difficulty=difficulty):
        after = stacked(d.next_perception.recent, frames)
        if states is not None:
            states.add(d.transition)
        yield Step(
            observation=stacked(d.perception.recent, frames) if before is None else before,
            action=d.action,
            reward=d.reward,
            next_observation=after,
            ending=None if d.ending is None else {**d.ending, "difficulty": difficulty},
            label=getattr(policy, "label", None),
            groups=None if d.ending is None else getattr(policy, "groups", None),
            explored=getattr(policy, "explored", False),
            privileged=None if states is None else states.rows[-2],
            next_privileged=None if states is None else states.rows[-1],
        )
        before = after
