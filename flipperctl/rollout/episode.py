"""The one episode loop.

In: an environment, a policy, a seed. Out: one ``Decision`` after the other, each made on request of
the iterator, so that the caller can learn, display, wait or stop in between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Perception, Policy, Transition
from flipperctl.env.actions import ALLOWED, action_index
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.observer import Observer
from flipperctl.errors import FlipperctlError
from flipperctl.policies.abilities import RiskPolicy
from flipperctl.rollout.risks import EpisodeRisks

Row = dict[str, Any]
"""Seed, outcome and metrics of one episode."""
SEARCH = "search_"
"""Prefix of the keys of a policy's search results."""


@dataclass(frozen=True)
class Decision:
    """One decision and its results."""

    perception: Perception
    """The policy's input."""
    action: int
    """Index of the chosen action."""
    reward: float
    """Sum of the weighted reward terms."""
    rewards: Mapping[str, float]
    """Weighted value of each reward term."""
    transition: Transition
    """True states before and after the decision, with the poses between at 100 Hz."""
    next_perception: Perception
    """What the robot perceives after the decision."""
    ending: Row | None
    """Seed, outcome and metrics of the episode after its last decision; None before."""

    @property
    def poses(self) -> FloatArray:
        """Poses (S + 1, 5) every 10 ms: x [m], z [m], pitch, front and rear flipper angle [rad]."""
        return np.column_stack([self.transition.path, self.transition.flippers])


def decisions(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    difficulty: float = 1.0,
    pace: Callable[[float], None] | None = None,
    report_progress: Callable[[float], None] = lambda fraction: None,
    observers: Sequence[Observer] = (),
) -> Iterator[Decision]:
    """Yield the decisions of one whole episode; stop iterating to cancel it.

    ``difficulty``: difficulty of the terrain, 0 to 1. ``pace`` is called before each decision with
    the time since the start of the episode [s], and may wait. ``report_progress`` is called with
    the completed fraction of the search by a policy that searches before it acts. ``observers`` see
    the episode's samples, measurements and decisions.

    Raises:
        FlipperctlError: the policy returned an action that does not exist.
    """
    env.observers = tuple(observers)
    env.reset(seed=seed, options={"difficulty": difficulty})
    simulator = env.simulator(report_progress)
    policy.reset(simulator)
    ending: Row | None = None
    risks, told = _risk_policy(policy), list[float]()
    while ending is None:
        if pace is not None:
            pace(env.state.time)
        perception = env.perception
        action = policy.act(perception)
        if action_index(action) is None:
            raise FlipperctlError(f"{type(policy).__name__}.act returned {action!r}; {ALLOWED}")
        if risks is not None and risks.risk is not None:
            told.append(risks.risk)
        _, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            ending = {"seed": seed, "outcome": str(info["outcome"]), **info["metrics"]}
            ending |= {f"{SEARCH}{name}": value for name, value in simulator.results.items()}
            if risks is not None and risks.risk_sign is not None:
                ending |= EpisodeRisks.of(risks.risk_sign, told).to_row()
        yield Decision(
            perception=perception,
            action=action,
            reward=reward,
            rewards=info["rewards"],
            transition=env.transition,
            next_perception=env.perception,
            ending=ending,
        )


def _risk_policy(policy: Policy) -> RiskPolicy | None:
    return policy if isinstance(policy, RiskPolicy) and policy.risk_sign is not None else None


def play(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    watch: Callable[[Decision], None] = lambda decision: None,
    report_progress: Callable[[float], None] = lambda fraction: None,
    observers: Sequence[Observer] = (),
) -> Row:
    """Play one episode to its end; return its seed, outcome and metrics.

    ``watch`` is called after each decision; ``observers`` also see the samples between decisions.
    """
    ending: Row | None = None
    for decision in decisions(
        env, policy, seed, report_progress=report_progress, observers=observers
    ):
        watch(decision)
        ending = decision.ending
    assert ending is not None  # decisions() yields until there is one
    return ending
