"""Speed of the engines: simulated time per second of CPU time.

A controller crosses the same ground in each engine. Its actions are repeated in turn by the engine
alone and by the environment, which also senses and computes rewards. Times are CPU times of this
process, since an engine uses one thread; on an idle core they are wall-clock times, and the
quotient is the multiple of real time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from benchmarks.settings import Benchmark, ratio
from flipperctl.api.plugin import registered_names
from flipperctl.bench import Values, measure_in_turn, quantity
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds

ABOUT = (
    "simulated time per second of CPU time (× real time on one core) of every engine and of the "
    "environment with it, in turn, with the same actions on the same ground"
)
ENGINE_GROUNDS = ("flat", "stair", "plum", "paper_stair")
"""Terrains on which engines are timed: level ground, edges, many edges, the paper's scene."""


@dataclass(frozen=True)
class Recording:
    """The seed and the actions of an episode."""

    seed: int
    actions: list[int]


class Clock:
    """Repeat episodes on one terrain in one engine; public methods return simulated / CPU time."""

    def __init__(self, config: EnvConfig, controller: str, seeds: list[int]) -> None:
        """Play the episodes once, which also triggers the compilation.

        Raises:
            MissingExtraError: the engine is not installed.
        """
        self._env = FlipperEnv(config=config)
        policy = load_policy(controller, "bench.controller").build(config)
        self._recordings = [
            Recording(seed, [d.action for d in decisions(self._env, policy, seed)])
            for seed in seeds
        ]

    def engine(self) -> float:
        """Time the engine alone: commands, simulation, sampled poses and termination."""
        simulated = spent = 0.0
        for recording in self._recordings:
            self._env.reset(seed=recording.seed)
            alone = self._env.simulator()
            before = alone.state.time  # building the world is not timed
            begun = time.process_time()
            for action in recording.actions:
                alone.step(action)
            spent += time.process_time() - begun
            simulated += alone.state.time - before
        return simulated / spent

    def environment(self) -> float:
        """Time whole steps of the environment."""
        simulated = spent = 0.0
        for recording in self._recordings:
            self._env.reset(seed=recording.seed)
            before = self._env.state.time
            begun = time.process_time()
            for action in recording.actions:
                self._env.step(action)
            spent += time.process_time() - begun
            simulated += self._env.state.time - before
        return simulated / spent


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure simulated time over CPU time [-] by engine and terrain, and ratios of the engines.

    The engine chosen by ``sim=…`` has its configured settings, the others have their defaults.
    """
    s = bench.settings
    clocks, missing = _clocks(bench)
    found: dict[str, list[float]] = measure_in_turn(
        {
            name: clock
            for key, one in clocks.items()
            for name, clock in ((key, one.engine), (f"{key}.environment", one.environment))
        },
        s.repeats,
        partial(_report, bench),
    )
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "-") for name, values in found.items()},
        "ratios": _ratios(found),
        "missing": missing,
    }


def _clocks(bench: Benchmark) -> tuple[dict[str, Clock], list[str]]:
    """Return the clock of each engine and terrain, and the reasons why engines are left out."""
    config, s = bench.config.environment(), bench.settings
    clocks: dict[str, Clock] = {}
    missing: list[str] = []
    for engine in registered_names("sim"):
        chosen = engine == config.sim.plugin_name
        changed = config if chosen else with_overrides(config, {"sim": engine})
        for ground in ENGINE_GROUNDS[: s.families]:
            bench.report_progress(f"recording {engine} on {ground}", 0.0)
            on_ground = with_overrides(changed, {"terrain": ground})
            seeds = EvaluationSeeds.of(s.seed, on_ground.terrain).first(s.episodes)
            try:
                clocks[f"{engine}.{ground}"] = Clock(on_ground, s.controller, seeds)
            except MissingExtraError as error:
                missing.append(str(error))
                break
    return clocks, missing


def _report(bench: Benchmark, fraction: float) -> None:
    bench.report_progress("engines in turn", fraction)


def _ratios(found: dict[str, list[float]]) -> dict[str, Any]:
    """Return the speed of each other engine relative to the default one."""
    ratios: dict[str, Any] = {}
    for name, values in found.items():
        engine, what = name.split(".", 1)
        default = f"{DEFAULT_ENGINE}.{what}"
        if engine != DEFAULT_ENGINE:
            below: Values = found[default]
            ratios[f"{name} / {default}"] = ratio(values, below)
    return ratios
