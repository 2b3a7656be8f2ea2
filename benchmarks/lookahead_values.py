"""Speed of searches on rewards: ``mpc`` with a value, and the values of a whole ground.

In: a training configuration, and the episodes that ``mpc`` plays without a value. Out: CPU times,
and their ratios to those of ``mpc`` without one. The network has random weights, which cost as much
as trained ones.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import torch

from flipperctl.agent.networks import build_network
from flipperctl.api import ACTIONS, Perception, Policy, Simulator
from flipperctl.bench.settings import Values, quantile, quantity, ratio
from flipperctl.config import EnvConfig, TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.controllers import Mpc, ValueIteration
from flipperctl.lookahead.mpc_policy import MpcPolicy
from flipperctl.policies.values import value_of
from flipperctl.rollout.episode import decisions

ABOUT = (
    "the same of mpc with the values of a network with random weights and the configured rewards; "
    "CPU time in which value_iteration computes the values of all states of a ground"
)


@dataclass
class TimedMpc:
    """The policy of ``mpc`` with a clock."""

    policy: MpcPolicy
    seconds: list[float] = field(default_factory=list)
    """CPU time of each decision [s]."""
    simulated: list[int] = field(default_factory=list)
    """Simulated decisions for each decision [-]."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        self.policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the action and record its CPU time."""
        begun = time.process_time()
        action = self.policy.act(p)
        self.seconds.append(time.process_time() - begun)
        self.simulated.append(self.policy.simulated)
        return action


@dataclass(frozen=True)
class Round:
    """Times of one round, which is an episode on each terrain."""

    plain: list[float]
    """CPU time of each decision of ``mpc`` without a value [s]."""
    valued: list[float]
    """CPU time of each decision of ``mpc`` with a value [s]."""
    graphs: list[float]
    """CPU time in which the values of each ground were computed [s]."""

    def and_then(self, other: Round) -> Round:
        """Return the times of both."""
        return Round(
            self.plain + other.plain, self.valued + other.valued, self.graphs + other.graphs
        )


@dataclass(frozen=True)
class Searches:
    """The policies that search on rewards."""

    mpc: MpcPolicy
    graph: Policy
    """That of ``value_iteration``."""

    @classmethod
    def of(cls, config: TrainConfig, seed: int) -> Searches:
        """Return them for the network and the rewards of a training; ``seed``: of the weights."""
        torch.manual_seed(seed)
        module = build_network(config.network, config.perception, len(ACTIONS)).eval()
        mpc = Mpc().ending_with(value_of(module, config)).build()
        graph = ValueIteration().paying(config.rewards).build()
        return cls(cast("MpcPolicy", mpc), graph)

    def play(self, config: EnvConfig, seed: int, plain: Sequence[float]) -> Round:
        """Time both on an episode of which ``plain`` has the times without a value.

        A random value leads nowhere, so as many decisions are made as without it.
        """
        env, timed = FlipperEnv(config=config), TimedMpc(self.mpc)
        for _ in itertools.islice(decisions(env, timed, seed), len(plain)):
            pass
        env.reset(seed=seed)
        begun = time.process_time()
        self.graph.reset(env.simulator())
        return Round(list(plain), timed.seconds, [time.process_time() - begun])


def rates(rounds: Sequence[Round]) -> dict[str, Any]:
    """Return quantities and ratios from the times of the rounds."""
    plain: Values = [len(r.plain) / sum(r.plain) for r in rounds]
    valued: Values = [len(r.valued) / sum(r.valued) for r in rounds]
    graphs: Values = [len(r.graphs) / sum(r.graphs) for r in rounds]
    seconds = [value for r in rounds for value in r.valued]
    return {
        "quantities": {
            "decision_with_value": quantity(seconds, "s"),
            "decision_with_value_p99": quantity([quantile(seconds, 0.99)], "s"),
            "graph": quantity([value for r in rounds for value in r.graphs], "s"),
            "decisions": quantity(plain, "1/s"),
            "decisions_with_value": quantity(valued, "1/s"),
            "graphs": quantity(graphs, "1/s"),
        },
        "ratios": {
            "decisions / decisions_with_value": ratio(plain, valued),
            "decisions / graphs": ratio(plain, graphs),
        },
    }
