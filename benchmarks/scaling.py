"""Decisions per second by the number of workers: in this process, in processes, on Ray."""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
import torch

from benchmarks.settings import Benchmark, quantity, ratio
from flipperctl.agent.risk import weights_of
from flipperctl.commands.speed import measure_in_turn
from flipperctl.config import RayCollector, TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ
from flipperctl.policies.acting import ExploringPolicy
from flipperctl.rollout.cluster import LOCAL, QUIET, is_connected, join
from flipperctl.rollout.collect import RayWorkers, RolloutWorkers
from flipperctl.rollout.episode import RolloutRequest, steps, training_seed

ABOUT = "decisions per second (ε-greedy on the network, no updates) by number of workers, in turn"
EPSILON = 0.05


Collect = Callable[[int], int]
"""Plays at least so many more decisions; returns their actual number."""


def in_process(config: TrainConfig) -> Collect:
    """Return the reference: one environment and one agent in this process, as in the trainer."""
    assert isinstance(config.agent, D3qn)
    agent = DoubleQ(config.network, config.perception, config.agent, seed=config.seed)
    env, rng = FlipperEnv(config=config.environment()), np.random.default_rng(config.seed)
    frames = config.network.frames
    policy = ExploringPolicy(agent.online, frames, lambda: EPSILON, rng, agent.noise_rng)
    played = (
        step
        for number in itertools.count()
        for step in steps(env, policy, training_seed(config.seed, number), frames=frames)
    )
    return lambda decisions: sum(1 for _ in itertools.islice(played, decisions))


def by_workers(config: TrainConfig, workers: RolloutWorkers) -> Collect:
    """Return a collector whose workers play with the weights of an untrained network."""
    assert isinstance(config.agent, D3qn)
    agent = DoubleQ(config.network, config.perception, config.agent, seed=config.seed)
    weights, numbers = weights_of(agent.online), itertools.count(1)

    def collect(decisions: int) -> int:
        """Play whole episodes, all of which end before this returns, so that no worker waits."""
        done = 0
        while done < decisions or workers.outstanding():
            while done < decisions and len(workers.outstanding()) < workers.capacity:
                number = next(numbers)
                seed = training_seed(config.seed, number)
                workers.send(RolloutRequest(number, seed, 0, 0, weights))
            _, played = workers.take(lambda: False) or (None, None)
            done += 0 if played is None else len(played)
        return done

    return collect


def worker_counts(cores: int | None = None) -> tuple[int, ...]:
    """Return the powers of two below the number of cores, and that number itself."""
    most = cores or os.cpu_count() or 1
    counts = [1]
    while counts[-1] * 2 < most:
        counts.append(counts[-1] * 2)
    return tuple(dict.fromkeys([*counts, most]))


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure decisions per second [1/s] of each collector, and their ratios.

    With a teacher, which labels what workers collect, and with a policy that draws its actions
    there is no collector in this process.
    """
    s, config, threads = bench.settings, bench.config, torch.get_num_threads()
    counts = s.workers or worker_counts()
    torch.set_num_threads(1)
    missing: list[str] = []
    clocks: dict[str, Callable[[], float]] = {}
    with ExitStack() as started:
        started.callback(torch.set_num_threads, threads)
        if config.teacher.controller is None and isinstance(config.agent, D3qn):
            clocks["in_process.1"] = _clock(in_process(config), s.decisions)
        try:
            for kind, count in itertools.product(("processes", "ray"), counts):
                bench.report_progress(f"starting {kind} with {count}", 0.0)
                workers: RolloutWorkers
                if kind == "ray":
                    if not is_connected():
                        more = {"num_cpus": sum(counts), "include_dashboard": False}
                        join(LOCAL, "bench", **more, **QUIET)
                        started.callback(lambda: sys.modules["ray"].shutdown())
                    workers = RayWorkers(RayCollector(workers=count), config)
                else:
                    workers = RolloutWorkers(count, config)
                started.callback(workers.close)
                clocks[f"{kind}.{count}"] = _clock(by_workers(config, workers), s.decisions * count)
        except MissingExtraError as error:
            missing.append(str(error))
        for clock in clocks.values():
            clock()  # warm-up
        rates = measure_in_turn(
            clocks, s.repeats, lambda done: bench.report_progress("collectors in turn", done)
        )
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


def _clock(collect: Collect, decisions: int) -> Callable[[], float]:
    def rate() -> float:
        begun = time.perf_counter()
        done = collect(decisions)
        return done / (time.perf_counter() - begun)

    return rate
