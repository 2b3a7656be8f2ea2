"""Updates per second of flipperctl's learner compared with Stable-Baselines3's DQN.

Both sample a replay of the same content, take one gradient step and make a soft update of the
target network; both use one torch thread, Huber loss, clipped gradients and Adam. SB3 gets a
perceptron with as many layers and, as nearly as integer widths allow, as many weights as
flipperctl's network. It is measured unchanged (``sb3``) and with torch's fused Adam
(``sb3_fused``). A call of flipperctl's learner makes ``agent.updates_together`` updates, as in
training; each of them is a gradient step of its own.
"""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS
from flipperctl.bench.extras import import_extra
from flipperctl.bench.settings import Bench
from flipperctl.bench.statistics import measure_in_turn, quantity, ratio
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.policies.function import FunctionPolicy
from flipperctl.rollout.collect import InProcessCollector
from flipperctl.rollout.seeds import training_seed

ABOUT = (
    "sample, gradient step and soft target update of our agent against Stable-Baselines3's DQN, "
    "same replay content, equal depth and size, one torch thread each, in turn"
)


def measure(bench: Bench) -> dict[str, Any]:
    """Measure updates and transitions per second [1/s] for each batch size, and their ratios."""
    s, config = bench.settings, bench.config
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        replay = fill(config, s.transitions, s.seed)
        missing = []
        result: dict[str, Any] = {"about": ABOUT, "weights": {}, "quantities": {}, "ratios": {}}
        for index, batch_size in enumerate(s.batch_sizes):
            contestants, result["weights"]["flipperctl"] = _ours(config, replay, batch_size, s.seed)
            try:
                other, result["weights"]["sb3"] = _theirs(config, replay, batch_size, s.seed)
                contestants |= other
            except MissingExtraError as error:
                missing = [str(error)]
            clocks = {n: _clock(*c, s.updates) for n, c in contestants.items()}
            for clock in clocks.values():
                clock()  # warm-up

            def report(fraction: float, done: int = index, size: int = batch_size) -> None:
                bench.report_progress(f"batches of {size}", (done + fraction) / len(s.batch_sizes))

            rates = measure_in_turn(clocks, s.repeats, report)
            _add_rates(result, rates, batch_size)
        return {**result, "missing": missing}
    finally:
        torch.set_num_threads(threads)


def _add_rates(result: dict[str, Any], rates: dict[str, list[float]], batch_size: int) -> None:
    for name, found in rates.items():
        result["quantities"][f"{name}.updates.{batch_size}"] = quantity(found, "1/s")
        result["quantities"][f"{name}.transitions.{batch_size}"] = quantity(
            [batch_size * rate for rate in found], "1/s"
        )
        if name != "flipperctl":
            key = f"flipperctl / {name}, updates of {batch_size}"
            result["ratios"][key] = ratio(rates["flipperctl"], found)


def fill(config: TrainConfig, count: int, seed: int) -> Replay:
    """Return a replay with ``count`` one-step transitions of a random policy."""
    size = input_size(config.network, config.perception)
    replay = Replay(count, size, 1, config.agent.gamma)
    rng, numbers = np.random.default_rng(seed), itertools.count()
    collector = InProcessCollector(
        FlipperEnv(config=config.environment()),
        FunctionPolicy(lambda _: int(rng.integers(len(ACTIONS)))),
        lambda: training_seed(seed, next(numbers)),
        frames=config.network.frames,
    )
    while True:
        for step in collector.episode():
            replay.add(
                step.observation,
                step.action,
                step.reward,
                step.next_observation,
                over=step.ending is not None,
                bootstrap=False,
            )
            if replay.added == count:
                return replay


def _clock(update: Callable[[], object], together: int, count: int) -> Callable[[], float]:
    calls = max(1, count // together)

    def rate() -> float:
        begun = time.perf_counter()
        for _ in range(calls):
            update()
        return calls * together / (time.perf_counter() - begun)

    return rate


Contestants = dict[str, tuple[Callable[[], object], int]]
"""Name → a function that updates, and the number of updates that a call of it makes [-]."""


def _ours(
    config: TrainConfig, replay: Replay, batch_size: int, seed: int
) -> tuple[Contestants, int]:
    settings = config.agent.model_copy(update={"batch_size": batch_size})
    agent = D3qn(config.network, config.perception, len(ACTIONS), settings, seed=seed)
    rng = np.random.default_rng(seed)
    count = sum(p.numel() for p in agent.online.parameters())
    together = settings.updates_together
    rows = together * batch_size
    return {"flipperctl": (lambda: agent.update(replay.sample(rows, rng), 0.0), together)}, count


def _theirs(
    config: TrainConfig, replay: Replay, batch_size: int, seed: int
) -> tuple[Contestants, int]:
    sb3 = import_extra("flipperctl.bench.sb3", "stable-baselines3", "bench")
    agent = D3qn(config.network, config.perception, len(ACTIONS), config.agent, seed=seed)
    wanted = sum(p.numel() for p in agent.online.parameters())
    layers = hidden_layers(agent.online, input_size(config.network, config.perception))
    width = equal_width(wanted, config.perception.size, len(ACTIONS), layers)
    contestants: Contestants = {}
    count = 0
    for name, fused in (("sb3", None), ("sb3_fused", True)):
        model = sb3.model(config, seed, net_arch=(width,) * layers, n_steps=1, fused=fused)
        sb3.fill(model, replay)
        contestants[name] = (sb3.updater(model, batch_size), 1)
        count = sum(p.numel() for p in model.q_net.parameters())
    return contestants, count


def hidden_layers(module: torch.nn.Module, inputs: int) -> int:
    """Return the number of linear layers on the longest path to the Q-values, without the last."""

    @functools.cache
    def longest(node: Any) -> int:
        earlier = [longest(inner) for inner, _ in node.next_functions if inner]
        return int(node.name().startswith("Addmm")) + max(earlier, default=0)

    return max(1, longest(module(torch.zeros(2, inputs)).grad_fn) - 1)


def equal_width(wanted: int, inputs: int, outputs: int, layers: int) -> int:
    """Return the width at which a perceptron of ``layers`` hidden layers has ``wanted`` weights.

    Of all integer widths, it is the one with the nearest number of weights.
    """

    def weights(width: int) -> int:
        inner = (layers - 1) * (width + 1) * width
        return (inputs + 1) * width + inner + (width + 1) * outputs

    width = 1
    while weights(width + 1) <= wanted:
        width += 1
    return min((width, width + 1), key=lambda w: abs(weights(w) - wanted))
