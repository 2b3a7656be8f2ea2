"""Updates per second of flipperctl's learner.

An update samples the replay, takes one gradient step and makes a soft update of the target
network, on one torch thread. A call of the learner makes ``agent.updates_together`` updates, as in
training, by priorities and with the privileged baseline if the training has them. The gradient
steps of a call are counted. With another ``device`` it is measured there, too.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from benchmarks.settings import Benchmark, quantity, ratio
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS
from flipperctl.commands.speed import measure_in_turn
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.privileged import SIZE
from flipperctl.errors import RequestError
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ
from flipperctl.policies.controllers import FunctionPolicy
from flipperctl.rollout.episode import steps, training_seed

ABOUT = "sample, gradient step and soft target update of the agent, on one torch thread"


@dataclass(frozen=True)
class Contestant:
    """A learner on a filled replay."""

    update: Callable[[], object]
    together: int
    """Gradient steps per call of ``update`` [-]."""
    weights: int
    """Weights of its network [-]."""


Rivals = Callable[[TrainConfig, Replay, int, int], Mapping[str, Contestant]]
"""Returns other learners by name, given configuration, replay, batch size and seed."""


def measure(bench: Benchmark, rivals: Rivals = lambda *_: {}) -> dict[str, Any]:
    """Measure updates and transitions per second [1/s] for each batch size.

    ``rivals`` take turns with flipperctl's learner.
    """
    s, config = bench.settings, bench.config
    if not isinstance(config.agent, D3qn):
        raise RequestError(
            f"learner: agent={config.agent.plugin_name} has other updates; the gradient steps of "
            "a double DQN alone are timed"
        )
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        replay = fill(config, s.transitions, s.seed)
        result: dict[str, Any] = {"about": ABOUT, "weights": {}, "quantities": {}, "ratios": {}}
        for index, batch_size in enumerate(s.batch_sizes):
            contestants = {
                **_ours(config, replay, batch_size, s.seed),
                **rivals(config, replay, batch_size, s.seed),
            }
            result["weights"] |= {name: c.weights for name, c in contestants.items()}
            clocks = {name: _clock(c, s.updates) for name, c in contestants.items()}
            for clock in clocks.values():
                clock()  # warm-up

            def report(fraction: float, done: int = index, size: int = batch_size) -> None:
                bench.report_progress(f"batches of {size}", (done + fraction) / len(s.batch_sizes))

            found = measure_in_turn(clocks, s.repeats, report)
            if (there := f"flipperctl on {config.device}") in found:
                name = f"{there} / flipperctl, batches of {batch_size}"
                result["ratios"][name] = ratio(found[there], found["flipperctl"])
            for name, rates in found.items():
                moved = [batch_size * rate for rate in rates]
                result["quantities"] |= {
                    f"{name}.updates.{batch_size}": quantity(rates, "1/s"),
                    f"{name}.transitions.{batch_size}": quantity(moved, "1/s"),
                }
        return result
    finally:
        torch.set_num_threads(threads)


def fill(config: TrainConfig, count: int, seed: int) -> Replay:
    """Return a replay with ``count`` one-step transitions of a random policy."""
    size = input_size(config.network, config.perception)
    privileged = config.agent.privileged(config)
    replay = Replay(
        *(count, size, 1, config.agent.gamma),
        privileged=SIZE if privileged else 0,
        prioritised=isinstance(config.agent, D3qn) and config.agent.priority > 0,
    )
    rng, number = np.random.default_rng(seed), itertools.count()
    env = FlipperEnv(config=config.environment())
    policy = FunctionPolicy(lambda _: int(rng.integers(len(ACTIONS))))
    while replay.added < count:
        seed_of_one = training_seed(seed, next(number))
        frames = config.network.frames
        for step in steps(env, policy, seed_of_one, frames=frames, privileged=privileged):
            assert isinstance(step.action, int)  # of turns
            replay.add(
                step.observation,
                step.action,
                step.reward,
                step.next_observation,
                over=step.ending is not None,
                bootstrap=False,
                privileged=step.privileged,
                next_privileged=step.next_privileged,
            )
            if replay.added == count:
                break
    return replay


def contestant(config: TrainConfig, replay: Replay, batch_size: int, seed: int) -> Contestant:
    """Return flipperctl's learner on the configuration's device."""
    assert isinstance(config.agent, D3qn)
    settings = config.agent.model_copy(update={"batch_size": batch_size})
    agent = DoubleQ(
        *(config.network, config.perception, settings),
        seed=seed,
        device=config.device,
        privileged=SIZE if config.agent.privileged(config) else 0,
    )
    rng = np.random.default_rng(seed)

    def update() -> float:
        return agent.update_from(replay, rng, 0.0)

    before = agent.optimiser.steps
    update()
    count = sum(p.numel() for p in agent.online.parameters())
    return Contestant(update, agent.optimiser.steps - before, count)


def _ours(config: TrainConfig, replay: Replay, batch_size: int, seed: int) -> dict[str, Contestant]:
    """Return flipperctl's learner on the CPU, and on the configured device if that is another."""
    on_cpu = config.model_copy(update={"device": "cpu"})
    found = {"flipperctl": contestant(on_cpu, replay, batch_size, seed)}
    if config.device != "cpu":
        found[f"flipperctl on {config.device}"] = contestant(config, replay, batch_size, seed)
    return found


def _clock(contestant: Contestant, updates: int) -> Callable[[], float]:
    calls = max(1, updates // contestant.together)

    def rate() -> float:
        begun = time.perf_counter()
        for _ in range(calls):
            contestant.update()
        return calls * contestant.together / (time.perf_counter() - begun)

    return rate
