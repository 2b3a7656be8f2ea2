"""Speed of the controller ``mpc`` at its defaults, and the accuracy of its prediction model.

Whole episodes on several terrains: in turn, ``mpc`` plays an episode and the environment replays
its actions. Times are CPU times of this process, which on an idle core are wall-clock times: the
controller uses one thread.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from benchmarks.prediction import MEASURES, prediction_errors
from benchmarks.settings import FAMILIES, Benchmark
from flipperctl.api import Perception, Simulator
from flipperctl.bench.statistics import Values, quantile, quantity, ratio
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.mpc import Mpc
from flipperctl.lookahead.policy import MpcPolicy
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds

ABOUT = (
    "CPU time of a decision of mpc at its defaults, without the first, which compiles; its "
    "simulated decisions against the environment's; errors of its prediction model against the "
    "engine after one decision"
)
_PLAYING = 0.8
"""Fraction of the progress bar for the episodes; the prediction errors take the rest."""


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

    seconds: list[float]
    """CPU time of each decision of ``mpc`` [s]."""
    simulated: list[int]
    """Simulated decisions for each of them [-]."""
    environment: float
    """CPU time of the environment's steps with the same actions [s]."""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure times [s] and rates [1/s] of decisions, and errors of predictions."""
    s, config = bench.settings, bench.config.environment()
    terrains = {f: with_overrides(config, {"terrain": f}) for f in FAMILIES[: s.families]}
    policy = Mpc().build()
    assert isinstance(policy, MpcPolicy)
    bench.report_progress("first decision, which compiles", 0.0)
    first = _first_decision(policy, config)
    rounds = []
    for index in range(s.repeats):
        found = Round([], [], 0.0)
        for done, (family, terrain) in enumerate(terrains.items()):
            fraction = (index + done / len(terrains)) / s.repeats
            bench.report_progress(f"mpc and environment on {family}", _PLAYING * fraction)
            one = play_in_turn(policy, terrain, EvaluationSeeds.of(s.seed, terrain.terrain)(index))
            found = Round(
                found.seconds + one.seconds,
                found.simulated + one.simulated,
                found.environment + one.environment,
            )
        rounds.append(found)
    summary = rates(rounds)
    summary["quantities"]["first_decision"] = quantity([first], "s")
    summary["quantities"] |= _predictions(bench, list(terrains.values()))
    return {"about": ABOUT, **summary, "decisions": sum(len(r.seconds) for r in rounds)}


def play_in_turn(policy: MpcPolicy, config: EnvConfig, seed: int) -> Round:
    """Play an episode with ``mpc``, then replay its actions in the environment."""
    env, timed = FlipperEnv(config=config), TimedMpc(policy)
    actions = [decision.action for decision in decisions(env, timed, seed)]
    env.reset(seed=seed)
    begun = time.process_time()
    for action in actions:
        env.step(action)
    return Round(timed.seconds, timed.simulated, time.process_time() - begun)


def rates(rounds: list[Round]) -> dict[str, Any]:
    """Return quantities and ratios from the times of the rounds."""
    simulated: Values = [sum(r.simulated) / sum(r.seconds) for r in rounds]
    environment: Values = [len(r.seconds) / r.environment for r in rounds]
    seconds = [value for r in rounds for value in r.seconds]
    return {
        "quantities": {
            "decision": quantity(seconds, "s"),
            "decision_p99": quantity([quantile(seconds, 0.99)], "s"),
            "simulated_per_decision": quantity([n for r in rounds for n in r.simulated], "-"),
            "simulated_decisions": quantity(simulated, "1/s"),
            "environment_decisions": quantity(environment, "1/s"),
        },
        "ratios": {
            "simulated_decisions / environment_decisions": ratio(simulated, environment),
        },
    }


def _first_decision(policy: MpcPolicy, config: EnvConfig) -> float:
    """Return the CPU time of the first decision [s], in which functions are compiled or loaded."""
    env, timed = FlipperEnv(config=config), TimedMpc(policy)
    for _ in decisions(env, timed, 0):  # the first step of an environment compiles too
        return timed.seconds[0]
    raise AssertionError("an episode has a decision")


def _predictions(bench: Benchmark, terrains: list[EnvConfig]) -> dict[str, Any]:
    """Return the prediction errors by controller and measure."""
    s = bench.settings
    quantities: dict[str, Any] = {}
    controllers = dict.fromkeys((s.controller, "random"))
    for index, name in enumerate(controllers):
        done = _PLAYING + (1 - _PLAYING) * index / len(controllers)
        bench.report_progress(f"predictions of {name}'s decisions", done)
        found = [
            prediction_errors(one, name, EvaluationSeeds.of(s.seed, one.terrain).first(s.episodes))
            for one in terrains
        ]
        for measure, unit in MEASURES.items():
            values = [value for errors in found for value in errors[measure]]
            key = f"prediction.{name}.{measure}"
            quantities[key] = quantity(values, unit)
            for percent in (90, 99):
                quantities[f"{key}_p{percent}"] = quantity([quantile(values, percent / 100)], unit)
    return quantities
