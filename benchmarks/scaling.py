"""Decisions per second by the number of worker processes.

``measure`` takes a factory for each kind of collector: in this process, in worker processes, on
Ray. A factory creates a collector with a given number of workers.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import torch

from benchmarks.settings import Benchmark, ratio
from flipperctl import plugins
from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.learner import arrays
from flipperctl.bench import measure_in_turn, quantity
from flipperctl.config import RayCollector, TrainConfig, to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.policies.trained import ExploringPolicy
from flipperctl.rollout.cluster import LOCAL, QUIET, is_connected, join
from flipperctl.rollout.collect import RayWorkers, RolloutWorkers
from flipperctl.rollout.seeds import training_seed
from flipperctl.rollout.steps import RolloutRequest, steps

ABOUT = "decisions per second (ε-greedy on the network, no updates) by number of workers, in turn"
EPSILON = 0.05


class Collector(Protocol):
    """A collector of training episodes."""

    def collect(self, decisions: int) -> int:
        """Play at least ``decisions`` more decisions; return their actual number."""

    def close(self) -> None:
        """Stop all worker processes."""


Factory = Callable[[TrainConfig, int], Collector]
"""Creates a collector from a configuration and a number of workers; raises MissingExtraError."""


class InProcessCollector:
    """The reference: one environment and one agent in this process, as in the trainer."""

    def __init__(self, config: TrainConfig, workers: int) -> None:
        """``workers`` must be 1; it is not used."""
        layout = config.perception
        self._agent = D3qn(config.network, layout, config.agent, seed=config.seed)
        self._decisions = self._play(config)

    def _play(self, config: TrainConfig) -> Iterator[None]:
        env, rng = FlipperEnv(config=config.environment()), np.random.default_rng(config.seed)
        policy = ExploringPolicy(
            self._agent.online, config.network.frames, lambda: EPSILON, rng, self._agent.noise_rng
        )
        for number in itertools.count():
            seed = training_seed(config.seed, number)
            for _ in steps(env, policy, seed, frames=config.network.frames):
                yield

    def collect(self, decisions: int) -> int:
        """Play exactly ``decisions`` more decisions."""
        for _ in range(decisions):
            next(self._decisions)
        return decisions

    def close(self) -> None:
        """Do nothing; no process was started."""


class WorkersCollector:
    """Request episodes from workers, with the weights of an untrained network."""

    def __init__(self, config: TrainConfig, workers: RolloutWorkers) -> None:
        layout = config.perception
        agent = D3qn(config.network, layout, config.agent, seed=config.seed)
        self._weights = arrays(agent.online)
        self._seed = config.seed
        self._workers = workers
        self._requested = 0

    def _request(self) -> RolloutRequest:
        self._requested += 1
        seed = training_seed(self._seed, self._requested)
        return RolloutRequest(self._requested, seed, EPSILON, 0, 0, self._weights)

    def collect(self, decisions: int) -> int:
        """Play whole episodes, all of which end before this returns, so that no worker waits."""
        workers, done = self._workers, 0
        while done < decisions or workers.outstanding():
            while done < decisions and len(workers.outstanding()) < workers.capacity:
                workers.send(self._request())
            _, played = workers.take(lambda: False) or (None, None)
            done += 0 if played is None else len(played)
        return done

    def close(self) -> None:
        """Stop the workers."""
        self._workers.close()


def process_collector(config: TrainConfig, workers: int) -> Collector:
    """Return a collector with the worker processes of ``train.workers``."""
    paths = plugins.configured_paths()
    return WorkersCollector(config, RolloutWorkers(workers, to_dict(config), paths))


def ray_collector(cpus: int) -> Factory:
    """Return the factory of ``collector=ray`` on one local cluster of ``cpus`` CPUs."""

    def create(config: TrainConfig, workers: int) -> Collector:
        if not is_connected():
            join(LOCAL, "bench", num_cpus=cpus, include_dashboard=False, **QUIET)
        settings = RayCollector(workers=workers)
        paths = plugins.configured_paths()
        return WorkersCollector(config, RayWorkers(settings, to_dict(config), paths))

    return create


def factories(
    config: TrainConfig, counts: tuple[int, ...]
) -> dict[str, tuple[Factory, tuple[int, ...]]]:
    """Return the factory and the numbers of workers of each kind of collector, by name.

    ``counts``: those of processes and of Ray workers. With a teacher, which labels what workers
    collect, and with a policy that draws its actions there is no collector in this process.
    """
    found: dict[str, tuple[Factory, tuple[int, ...]]] = {
        "processes": (process_collector, counts),
        "ray": (ray_collector(sum(counts)), counts),
    }
    if config.teacher.controller is not None or config.agent.is_policy_gradient:
        return found
    return {"in_process": (InProcessCollector, (1,)), **found}


def worker_counts(cores: int | None = None) -> tuple[int, ...]:
    """Return the powers of two below the number of cores, and that number itself."""
    most = cores or os.cpu_count() or 1
    counts = [1]
    while counts[-1] * 2 < most:
        counts.append(counts[-1] * 2)
    return tuple(dict.fromkeys([*counts, most]))


def measure(
    bench: Benchmark, found: Mapping[str, tuple[Factory, tuple[int, ...]]] | None = None
) -> dict[str, Any]:
    """Measure decisions per second [1/s] of each collector, and their ratios."""
    s, threads = bench.settings, torch.get_num_threads()
    counts = s.workers or worker_counts()
    torch.set_num_threads(1)
    collectors: dict[str, Collector] = {}
    missing: list[str] = []
    try:
        for name, (factory, numbers) in (found or factories(bench.config, counts)).items():
            try:
                for workers in numbers:
                    bench.report_progress(f"starting {name} with {workers}", 0.0)
                    collectors[f"{name}.{workers}"] = factory(bench.config, workers)
            except MissingExtraError as error:
                missing.append(str(error))
        clocks = {
            name: _clock(made, s.decisions * int(name.rpartition(".")[2]))
            for name, made in collectors.items()
        }
        for clock in clocks.values():
            clock()  # warm-up
        rates = measure_in_turn(
            clocks,
            s.repeats,
            lambda fraction: bench.report_progress("collectors in turn", fraction),
        )
    finally:
        for made in collectors.values():
            made.close()
        if (ray := sys.modules.get("ray")) is not None:
            ray.shutdown()
        torch.set_num_threads(threads)
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "1/s") for name, values in rates.items()},
        "ratios": {f"{a} / {b}": ratio(rates[a], rates[b]) for a, b in pairs(list(rates))},
        "missing": missing,
    }


def pairs(names: list[str]) -> list[tuple[str, str]]:
    """Return the pairs to compare.

    Each collector is compared with the first one and with one worker of its kind, and Ray also with
    as many processes.
    """
    found = [(name, names[0]) for name in names[1:]]
    for name in names:
        kind, _, count = name.rpartition(".")
        found += [(name, f"{kind}.1")] if count != "1" else []
        found += [(name, f"processes.{count}")] if kind == "ray" else []
    return list(dict.fromkeys((a, b) for a, b in found if b in names))


def _clock(collector: Collector, decisions: int) -> Callable[[], float]:
    def rate() -> float:
        begun = time.perf_counter()
        done = collector.collect(decisions)
        return done / (time.perf_counter() - begun)

    return rate
