"""Speed of searches, and the accuracy of ``mpc``'s prediction model.

Whole episodes on several terrains: in turn, ``mpc`` plays an episode with its hand-set cost, the
environment replays its actions, ``mpc`` plays it with the values of a network, whose weights are
random and cost as much as trained ones, and ``value_iteration`` computes the values of the ground.
Times are CPU times of this process, which on an idle core are wall-clock times: the controllers use
one thread. The prediction model knows the true ground, robot and state before each decision, so
that only its simplifications cause errors: a rigid robot with ideal servos, and long time steps.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import torch

from benchmarks.settings import FAMILIES, Benchmark, Values, quantile, quantity, ratio
from flipperctl.agent.networks import build_network
from flipperctl.api import ACTIONS, Perception, Simulator
from flipperctl.config import EnvConfig, TrainConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead import Mpc, ValueIteration
from flipperctl.lookahead.model import Model
from flipperctl.lookahead.mpc import MpcPolicy
from flipperctl.policies.source import load_policy
from flipperctl.policies.trained import value_of
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.testing.policies import one_thread

ABOUT = (
    "CPU time of a decision of mpc with its hand-set cost, without the first, which compiles; its "
    "simulated decisions against the environment's; errors of its prediction model against the "
    "engine after one decision; the same of mpc with the values of a network with random weights "
    "and the configured rewards; CPU time in which value_iteration computes the values of all "
    "states of a ground"
)
_PLAYING = 0.9
"""Fraction of the progress bar for the episodes; the prediction errors take the rest."""
MEASURES = {"position": "m", "pitch": "rad", "swing": "rad"}
"""Measures of an error and their units: distance of the chassis centres, and absolute differences
of pitch and of the sum of pitch changes within the decision."""
Times = Mapping[str, list[float]]
"""Of one round: ``plain`` and ``valued``, CPU time of each decision of ``mpc`` without a value and
with one; ``environment``, of the environment's steps with the same actions; ``graphs``, in which
the values of each ground were computed [s]; ``simulated``, decisions for each of the plain ones."""


@dataclass
class TimedMpc:
    """The policy of ``mpc`` with a clock."""

    policy: MpcPolicy
    seconds: list[float] = field(default_factory=list)
    """CPU time of each decision [s]."""
    simulated: list[float] = field(default_factory=list)
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


class Searches:
    """The policies that search, for the network and the rewards of a training."""

    def __init__(self, config: TrainConfig, seed: int) -> None:
        """``seed``: of the network's weights."""
        torch.manual_seed(seed)
        module = build_network(config.network, config.perception, len(ACTIONS)).eval()
        self.plain = cast("MpcPolicy", Mpc(value="").build())
        self.valued = cast("MpcPolicy", Mpc().ending_with(value_of(module, config)).build())
        self.graph = ValueIteration().paying(config.rewards).build()

    def first_decision(self, config: EnvConfig) -> float:
        """Return the CPU time of the first decision [s], in which functions are compiled."""
        env, timed = FlipperEnv(config=config), TimedMpc(self.plain)
        next(iter(decisions(env, timed, 0)))  # the first step of an environment compiles too
        return timed.seconds[0]

    def play(self, config: EnvConfig, seed: int, most: int | None = None) -> Times:
        """Play an episode, or its first decisions, with each search; return their times.

        A random value leads nowhere, so as many decisions are made as without it.
        """
        env, plain, valued = FlipperEnv(config=config), TimedMpc(self.plain), TimedMpc(self.valued)
        made = itertools.islice(decisions(env, plain, seed), most)
        actions = [decision.action for decision in made]
        env.reset(seed=seed)
        begun = time.process_time()
        for action in actions:
            env.step(action)
        environment = time.process_time() - begun
        for _ in itertools.islice(decisions(env, valued, seed), len(actions)):
            pass
        env.reset(seed=seed)
        begun = time.process_time()
        self.graph.reset(env.simulator())
        return {
            "plain": plain.seconds,
            "simulated": plain.simulated,
            "environment": [environment],
            "valued": valued.seconds,
            "graphs": [time.process_time() - begun],
        }


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure times [s] and rates [1/s] of decisions, and errors of predictions."""
    s, config = bench.settings, bench.config.environment()
    terrains = {f: with_overrides(config, {"terrain": f}) for f in FAMILIES[: s.families]}
    searches = Searches(bench.config, s.seed)
    bench.report_progress("first decision, which compiles", 0.0)
    first = searches.first_decision(config)
    rounds: list[Times] = []
    with one_thread():
        searches.play(config, 0, 1)  # which compiles
        for index in range(s.repeats):
            found: dict[str, list[float]] = defaultdict(list)
            for done, (family, terrain) in enumerate(terrains.items()):
                fraction = (index + done / len(terrains)) / s.repeats
                bench.report_progress(f"searches and environment on {family}", _PLAYING * fraction)
                seed = EvaluationSeeds.of(s.seed, terrain.terrain)(index)
                for name, values in searches.play(terrain, seed).items():
                    found[name] += values
            rounds.append(found)

    def of_all(name: str) -> list[float]:
        return [value for r in rounds for value in r[name]]

    def rate(name: str, by: str) -> Values:
        return [len(r[name]) / sum(r[by]) for r in rounds]

    simulated: Values = [sum(r["simulated"]) / sum(r["plain"]) for r in rounds]
    plain, valued, graphs = (rate(name, name) for name in ("plain", "valued", "graphs"))
    environment = rate("plain", "environment")
    return {
        "about": ABOUT,
        "quantities": {
            "decision": quantity(of_all("plain"), "s"),
            "decision_p99": quantity([quantile(of_all("plain"), 0.99)], "s"),
            "simulated_per_decision": quantity(of_all("simulated"), "-"),
            "simulated_decisions": quantity(simulated, "1/s"),
            "environment_decisions": quantity(environment, "1/s"),
            "decision_with_value": quantity(of_all("valued"), "s"),
            "decision_with_value_p99": quantity([quantile(of_all("valued"), 0.99)], "s"),
            "graph": quantity(of_all("graphs"), "s"),
            "decisions": quantity(plain, "1/s"),
            "decisions_with_value": quantity(valued, "1/s"),
            "graphs": quantity(graphs, "1/s"),
            "first_decision": quantity([first], "s"),
            **_predictions(bench, list(terrains.values())),
        },
        "ratios": {
            "simulated_decisions / environment_decisions": ratio(simulated, environment),
            "decisions / decisions_with_value": ratio(plain, valued),
            "decisions / graphs": ratio(plain, graphs),
        },
        "decisions": sum(len(r["plain"]) for r in rounds),
    }


def _predictions(bench: Benchmark, terrains: Sequence[EnvConfig]) -> dict[str, Any]:
    """Return the prediction errors by controller and measure."""
    s = bench.settings
    quantities: dict[str, Any] = {}
    controllers = dict.fromkeys((s.controller, "random"))
    for index, name in enumerate(controllers):
        done = _PLAYING + (1 - _PLAYING) * index / len(controllers)
        bench.report_progress(f"predictions of {name}'s decisions", done)
        errors: dict[str, list[float]] = {measure: [] for measure in MEASURES}
        for one in terrains:
            seeds = EvaluationSeeds.of(s.seed, one.terrain).first(s.episodes)
            for measure, values in prediction_errors(one, name, seeds).items():
                errors[measure] += values
        for measure, unit in MEASURES.items():
            key, values = f"prediction.{name}.{measure}", errors[measure]
            quantities[key] = quantity(values, unit)
            for percent in (90, 99):
                quantities[f"{key}_p{percent}"] = quantity([quantile(values, percent / 100)], unit)
    return quantities


def prediction_errors(
    config: EnvConfig, controller: str, seeds: Sequence[int]
) -> dict[str, list[float]]:
    """Return the errors of each decision of a controller's episodes, by the names of ``MEASURES``.

    The last decision of an episode is left out, since the engine ends it early.
    """
    env, s = FlipperEnv(config=config), Mpc(value="")
    policy = load_policy(controller, "bench.controller").build(config)
    errors: dict[str, list[float]] = {name: [] for name in MEASURES}
    for seed in seeds:
        model = None
        for decision in decisions(env, policy, seed):
            if decision.ending is not None:
                break
            model = model or Model(
                env.profile.points,
                env.robot,
                friction=s.assumed_friction,
                step=s.step,
                iterations=s.iterations,
                overturn=s.overturn,
            )
            t, before = decision.transition, decision.transition.before
            (x, z), (vx, vz) = map(float, before.position), map(float, before.velocity)
            rates = vx, vz, before.pitch_rate
            state = model.state((x, z, before.pitch), (before.front, before.rear), rates)
            targets = np.array([env.drive.targets])
            branch = model.expand(state[None], targets, env.config.robot.decision_period)
            variation = np.abs(np.diff(t.path[:, 2])).sum()
            errors["position"].append(math.dist(branch.places[0], t.after.position))
            errors["pitch"].append(abs(float(branch.states[0, 2]) - t.after.pitch))
            errors["swing"].append(abs(float(branch.pitch_variation[0] - variation)))
    return errors
