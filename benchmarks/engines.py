"""Speed of the engines: simulated time per second of CPU time.

A controller crosses the same ground in each engine. Its actions are repeated in turn by the engine
alone and by the environment, which also senses and computes rewards. Times are CPU times of this
process, since an engine uses one thread; on an idle core they are wall-clock times, and the
quotient is the multiple of real time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from benchmarks.settings import Benchmark, quantity, ratio
from flipperctl.api import Simulator
from flipperctl.api.plugin import registered_names
from flipperctl.commands.speed import measure_in_turn
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds, decisions

ABOUT = (
    "simulated time per second of CPU time (× real time on one core) of every engine and of the "
    "environment with it, in turn, with the same actions on the same ground"
)
ENGINE_GROUNDS = ("flat", "stair", "plum", "paper_stair")
"""Terrains on which engines are timed: level ground, edges, many edges, the paper's scene."""


class Clock:
    """Repeat episodes on one terrain in one engine; public methods return simulated / CPU time."""

    def __init__(self, config: EnvConfig, controller: str, seeds: list[int]) -> None:
        """Play the episodes once, which also triggers the compilation."""
        self._env = FlipperEnv(config=config)
        policy = load_policy(controller, "bench.controller").build(config)
        self._played = {
            seed: [d.action for d in decisions(self._env, policy, seed)] for seed in seeds
        }

    def engine(self) -> float:
        """Time the engine alone: commands, simulation, sampled poses and termination."""
        return self._time(lambda: self._env.simulator())

    def environment(self) -> float:
        """Time whole steps of the environment."""
        return self._time(lambda: self._env)

    def _time(self, stepped: Callable[[], FlipperEnv | Simulator]) -> float:
        simulated = spent = 0.0
        for seed, actions in self._played.items():
            self._env.reset(seed=seed)
            it = stepped()  # building the world is not timed
            before, begun = it.state.time, time.process_time()
            for action in actions:
                it.step(action)
            spent += time.process_time() - begun
            simulated += it.state.time - before
        return simulated / spent


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure simulated time over CPU time [-] by engine and terrain, and ratios of the engines.

    The engine chosen by ``sim=…`` has its configured settings, the others have their defaults.
    """
    s, config = bench.settings, bench.config.environment()
    clocks: dict[str, Callable[[], float]] = {}
    missing: list[str] = []
    for engine in registered_names("sim"):
        chosen = engine == config.sim.plugin_name
        changed = config if chosen else with_overrides(config, {"sim": engine})
        for ground in ENGINE_GROUNDS[: s.families]:
            bench.report_progress(f"recording {engine} on {ground}", 0.0)
            on_ground = with_overrides(changed, {"terrain": ground})
            seeds = EvaluationSeeds.of(s.seed, on_ground.terrain).first(s.episodes)
            try:
                one = Clock(on_ground, s.controller, seeds)
            except MissingExtraError as error:
                missing.append(str(error))
                break
            name = f"{engine}.{ground}"
            clocks |= {name: one.engine, f"{name}.environment": one.environment}
    found = measure_in_turn(
        clocks, s.repeats, lambda done: bench.report_progress("engines in turn", done)
    )
    ratios = {}
    for name, values in found.items():
        default = f"{DEFAULT_ENGINE}.{name.partition('.')[2]}"
        if name != default:
            ratios[f"{name} / {default}"] = ratio(values, found[default])
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "-") for name, values in found.items()},
        "ratios": ratios,
        "missing": missing,
    }
