"""Updates a second of our learner against Stable-Baselines3's DQN.

Both draw from a replay of the same content, take one gradient step and move the target network
softly; both have one torch thread, Huber loss, clipped gradients and Adam. SB3 gets a perceptron
of as many layers and, as nearly as whole widths allow, as many weights as our network has. It is
measured as it comes (``sb3``) and with torch's fused Adam (``sb3_fused``). Ours makes
``agent.updates_together`` updates a call, as in training; each is a gradient step of its own.
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
from flipperctl.bench.extras import extra
from flipperctl.bench.settings import Bench
from flipperctl.bench.spread import in_turn, quantity, ratio
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.policies.function import FunctionPolicy
from flipperctl.rollout.collect import InProcessCollector
from flipperctl.rollout.seeds import episode_seed

ABOUT = (
    "sample, gradient step and soft target update of our agent against Stable-Baselines3's DQN, "
    "same replay content, equal depth and size, one torch thread each, in turn"
)


def measure(bench: Bench) -> dict[str, Any]:
    """Updates and transitions a second [1/s] for each batch size, and our gain."""
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
                clock()  # warms up

            def tell(share: float, done: int = index, size: int = batch_size) -> None:
                bench.tell(f"batches of {size}", (done + share) / len(s.batch_sizes))

            rates = in_turn(clocks, s.repeats, tell)
            _note(result, rates, batch_size)
        return {**result, "missing": missing}
    finally:
        torch.set_num_threads(threads)


def _note(result: dict[str, Any], rates: dict[str, list[float]], batch_size: int) -> None:
    for name, found in rates.items():
        result["quantities"][f"{name}.updates.{batch_size}"] = quantity(found, "1/s")
        result["quantities"][f"{name}.transitions.{batch_size}"] = quantity(
            [batch_size * rate for rate in found], "1/s"
        )
        if name != "flipperctl":
            key = f"flipperctl / {name}, updates of {batch_size}"
            result["ratios"][key] = ratio(rates["flipperctl"], found)


def fill(config: TrainConfig, count: int, seed: int) -> Replay:
    """A replay of single decisions of random episodes, ``count`` of them."""
    size = input_size(config.network, config.perception)
    replay = Replay(count, size, 1, config.agent.gamma)
    rng, numbers = np.random.default_rng(seed), itertools.count()
    played = InProcessCollector(
        FlipperEnv(config=config.environment()),
        FunctionPolicy(lambda _: int(rng.integers(len(ACTIONS)))),
        lambda: episode_seed("training", seed, next(numbers)),
        frames=config.network.frames,
    )
    while True:
        for step in played.episode():
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
"""By name: a call, and the updates that it makes."""


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
    sb3 = extra("flipperctl.bench.sb3", "stable-baselines3", "bench")
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
    """Linear layers on the longest way from observation to Q-values, without the last."""

    @functools.cache
    def longest(node: Any) -> int:
        behind = [longest(following) for following, _ in node.next_functions if following]
        return int(node.name().startswith("Addmm")) + max(behind, default=0)

    return max(1, longest(module(torch.zeros(2, inputs)).grad_fn) - 1)


def equal_width(wanted: int, inputs: int, outputs: int, layers: int) -> int:
    """Width of a perceptron with ``layers`` hidden layers that has about ``wanted`` weights."""

    def weights(width: int) -> int:
        inner = (layers - 1) * (width + 1) * width
        return (inputs + 1) * width + inner + (width + 1) * outputs

    width = 1
    while weights(width + 1) <= wanted:
        width += 1
    return min((width, width + 1), key=lambda w: abs(weights(w) - wanted))
