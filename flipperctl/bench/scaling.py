"""Decisions a second over the number of collecting processes.

A factory makes a collector with so many workers; whatever collects decisions (in this process,
in worker processes, through Ray) is measured by giving ``measure`` one factory for it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.api import ACTIONS
from flipperctl.bench.settings import Bench
from flipperctl.bench.spread import in_turn, quantity, ratio
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.run.seeds import episode_seed

ABOUT = "decisions collected a second (ε-greedy on the network, no updates), over workers, in turn"
EPSILON = 0.05


class Collector(Protocol):
    """Something that plays training episodes."""

    def collect(self, decisions: int) -> int:
        """Play at least so many decisions more; returns how many it was."""

    def close(self) -> None:
        """End what was started."""


Factory = Callable[[TrainConfig, int], Collector]
"""From a configuration and a number of workers to a collector; raises MissingExtraError."""


class InProcess:
    """One environment and one agent in this process, as the trainer has them: the reference."""

    def __init__(self, config: TrainConfig, workers: int) -> None:
        """``workers`` is 1."""
        layout = config.perception
        self._agent = D3qn(config.network, layout, len(ACTIONS), config.agent, seed=config.seed)
        self._played = self._play(config)

    def _play(self, config: TrainConfig) -> Iterator[None]:
        env, rng = FlipperEnv(config=config.environment()), np.random.default_rng(config.seed)
        episode = 0
        while True:
            observation, _ = env.reset(seed=episode_seed("training", config.seed, episode))
            episode, over = episode + 1, False
            while not over:
                action = self._agent.act(observation, EPSILON, rng)
                observation, _, terminated, truncated, _ = env.step(action)
                over = terminated or truncated
                yield

    def collect(self, decisions: int) -> int:
        """Play exactly so many decisions more."""
        for _ in range(decisions):
            next(self._played)
        return decisions

    def close(self) -> None:
        """Nothing was started."""


def factories() -> dict[str, tuple[Factory, tuple[int, ...]]]:
    """What is measured: a name, its factory, and the numbers of workers.

    This is the place for other collectors: over processes, ``worker_counts()``; over Ray alike.
    """
    return {"in_process": (InProcess, (1,))}


def worker_counts(cores: int | None = None) -> tuple[int, ...]:
    """1, 2, 4, … up to the number of cores, which is always the last."""
    most = cores or os.cpu_count() or 1
    counts = [1]
    while counts[-1] * 2 < most:
        counts.append(counts[-1] * 2)
    return tuple(dict.fromkeys([*counts, most]))


def measure(
    bench: Bench, found: Mapping[str, tuple[Factory, tuple[int, ...]]] | None = None
) -> dict[str, Any]:
    """Decisions a second [1/s] of each collector, and its gain over the first one."""
    s, threads = bench.settings, torch.get_num_threads()
    torch.set_num_threads(1)
    collectors: dict[str, Collector] = {}
    missing: list[str] = []
    try:
        for name, (factory, counts) in (found or factories()).items():
            try:
                for workers in counts:
                    bench.tell(f"starting {name} with {workers}", 0.0)
                    collectors[f"{name}.{workers}"] = factory(bench.config, workers)
            except MissingExtraError as error:
                missing.append(str(error))
        clocks = {name: _clock(made, s.decisions) for name, made in collectors.items()}
        for clock in clocks.values():
            clock()  # warms up
        rates = in_turn(clocks, s.repeats, lambda share: bench.tell("collectors in turn", share))
    finally:
        for made in collectors.values():
            made.close()
        torch.set_num_threads(threads)
    first, *others = rates
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "1/s") for name, values in rates.items()},
        "ratios": {f"{name} / {first}": ratio(rates[name], rates[first]) for name in others},
        "missing": missing,
    }


def _clock(collector: Collector, decisions: int) -> Callable[[], float]:
    def rate() -> float:
        begun = time.perf_counter()
        done = collector.collect(decisions)
        return done / (time.perf_counter() - begun)

    return rate
