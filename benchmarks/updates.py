"""Updates per second of flipperctl's learner compared with Stable-Baselines3's DQN.

Both sample a replay of the same content, take one gradient step and make a soft update of the
target network; both use one torch thread, Huber loss, clipped gradients and Adam. SB3 gets a
perceptron with as many layers and, as nearly as integer widths allow, as many weights as
flipperctl's network. It is measured unchanged (``sb3``) and with torch's fused Adam
(``sb3_fused``).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import torch

from benchmarks import learner
from benchmarks.learner import Contestant
from benchmarks.settings import MISSING, Benchmark, ratio
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ

ABOUT = (
    "sample, gradient step and soft target update of our agent against Stable-Baselines3's DQN, "
    "same replay content, equal depth and size, one torch thread each, in turn"
)


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure updates and transitions per second [1/s] for each batch size, and their ratios."""
    installed = find_spec("stable_baselines3") is not None
    found = learner.measure(bench, rivals) if installed else learner.measure(bench)
    quantities, ratios = found["quantities"], {}
    for size in bench.settings.batch_sizes:
        for name in [name for name in found["weights"] if name != "flipperctl"]:
            both = (quantities[f"{one}.updates.{size}"]["values"] for one in ("flipperctl", name))
            ratios[f"flipperctl / {name}, updates of {size}"] = ratio(*both)
    missing = [] if installed else [MISSING]
    return {**found, "ratios": ratios, "about": ABOUT, "missing": missing}


def rivals(
    config: TrainConfig, replay: Replay, batch_size: int, seed: int
) -> Mapping[str, Contestant]:
    """Return Stable-Baselines3's DQN, unchanged and with torch's fused Adam."""
    from benchmarks import sb3

    assert isinstance(config.agent, D3qn)  # which the benchmark of learners has checked
    agent = DoubleQ(config.network, config.perception, config.agent, seed=seed)
    wanted = sum(p.numel() for p in agent.online.parameters())
    layers = hidden_layers(agent.online, input_size(config.network, config.perception))
    width = equal_width(wanted, config.perception.size, len(ACTIONS), layers)
    contestants = {}
    for name, fused in (("sb3", None), ("sb3_fused", True)):
        model = sb3.model(config, seed, net_arch=(width,) * layers, n_steps=1, fused=fused)
        sb3.fill(model, replay)
        count = sum(p.numel() for p in model.q_net.parameters())
        contestants[name] = Contestant(sb3.updater(model, batch_size), 1, count)
    return contestants


def hidden_layers(module: torch.nn.Module, inputs: int) -> int:
    """Return the number of linear layers on the longest path to the Q-values, minus the last."""

    @functools.cache
    def longest(node: Any) -> int:
        earlier = [longest(inner) for inner, _ in node.next_functions if inner]
        return int(node.name().startswith("Addmm")) + max(earlier, default=0)

    return max(1, longest(module(torch.zeros(2, inputs)).grad_fn) - 1)


def equal_width(wanted: int, inputs: int, outputs: int, layers: int) -> int:
    """Return the width of ``layers`` hidden layers whose weights number closest to ``wanted``."""

    def weights(width: int) -> int:
        inner = (layers - 1) * (width + 1) * width
        return (inputs + 1) * width + inner + (width + 1) * outputs

    width = 1
    while weights(width + 1) <= wanted:
        width += 1
    return min((width, width + 1), key=lambda w: abs(weights(w) - wanted))
