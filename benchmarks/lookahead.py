"""Speed of the controller ``mpc`` with its hand-set cost, and the accuracy of its prediction model.

Whole episodes on several terrains: in turn, ``mpc`` plays an episode, the environment replays its
actions, and the searches on rewards (``lookahead_values``) play it as well. Times are CPU times of
this process, which on an idle core are wall-clock times: the controller uses one thread.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from benchmarks import lookahead_values
from benchmarks.lookahead_values import Searches, TimedMpc
from benchmarks.prediction import MEASURES, prediction_errors
from benchmarks.settings import FAMILIES, Benchmark
from flipperctl.bench.settings import Values, quantile, quantity, ratio
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.controllers import Mpc
from flipperctl.lookahead.mpc_policy import MpcPolicy
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds
from flipperctl.testing.network import one_thread

ABOUT = (
    "CPU time of a decision of mpc with its hand-set cost, without the first, which compiles; its "
    "simulated decisions against the environment's; errors of its prediction model against the "
    f"engine after one decision; {lookahead_values.ABOUT}"
)
_PLAYING = 0.9
"""Fraction of the progress bar for the episodes; the prediction errors take the rest."""


@dataclass(frozen=True)
class Round:
    """Times of one round, which is an episode on each terrain."""

    seconds: list[float]
    """CPU time of each decision of ``mpc`` [s]."""
    simulated: list[int]
    """Simulated decisions for each of them [-]."""
    environment: float
    """CPU time of the environment's steps with the same actions [s]."""

    def and_then(self, other: Round) -> Round:
        """Return the times of both."""
        return Round(
            self.seconds + other.seconds,
            self.simulated + other.simulated,
            self.environment + other.environment,
        )


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure times [s] and rates [1/s] of decisions, and errors of predictions."""
    s, config = bench.settings, bench.config.environment()
    terrains = {f: with_overrides(config, {"terrain": f}) for f in FAMILIES[: s.families]}
    policy = Mpc(value="").build()
    assert isinstance(policy, MpcPolicy)
    bench.report_progress("first decision, which compiles", 0.0)
    first = _first_decision(policy, config)
    searches = Searches.of(bench.config, s.seed)
    rounds, on_rewards = [], []
    with one_thread():
        searches.play(config, 0, [first])  # which compiles
        for index in range(s.repeats):
            found, valued = Round([], [], 0.0), lookahead_values.Round([], [], [])
            for done, (family, terrain) in enumerate(terrains.items()):
                fraction = (index + done / len(terrains)) / s.repeats
                bench.report_progress(f"searches and environment on {family}", _PLAYING * fraction)
                seed = EvaluationSeeds.of(s.seed, terrain.terrain)(index)
                found = found.and_then(one := play_in_turn(policy, terrain, seed))
                valued = valued.and_then(searches.play(terrain, seed, one.seconds))
            rounds.append(found)
            on_rewards.append(valued)
    summary, more = rates(rounds), lookahead_values.rates(on_rewards)
    for section, values in more.items():
        summary[section] |= values
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
