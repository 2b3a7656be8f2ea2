"""Networks of plugins: one that does not fit is named; what their Q-values may depend on."""

import copy
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from flipperctl.agent.contract import check_contract
from flipperctl.checkpoint import join
from flipperctl.errors import ConfigError
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ
from tests.agent.learners import ACTIONS, LAYOUT, Foreign, fixed_batch


class Changed(nn.Module):
    """A linear layer whose forward is a function of the module and its input."""

    def __init__(self, forward: Callable[[Any, torch.Tensor], torch.Tensor]) -> None:
        super().__init__()
        self.layer, self.change = nn.Linear(LAYOUT.size, ACTIONS), forward
        self.cell, self.kept = nn.GRUCell(LAYOUT.size, LAYOUT.size), torch.zeros(1, LAYOUT.size)
        self.register_buffer("seen", torch.zeros(LAYOUT.size))
        self.own = np.random.default_rng(0)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.change(self, x)


def remembering(m: Any, x: torch.Tensor) -> torch.Tensor:
    kept = m.kept if len(m.kept) == len(x) else torch.zeros(len(x), LAYOUT.size)
    m.kept = m.cell(x, kept).detach()
    return m.layer(m.kept)


def following(m: Any, x: torch.Tensor) -> torch.Tensor:
    m.seen.lerp_(x.mean(dim=0), 0.1)
    return m.layer(x)


class DrawsElsewhere(nn.Linear):
    """Its noise comes from another generator than ``rng``."""

    def __init__(self, draw: Callable[[], float]) -> None:
        super().__init__(LAYOUT.size, ACTIONS)
        self.draw, self.noise = draw, 0.0

    def draw_noise(self, rng: np.random.Generator) -> None:
        self.noise = self.draw()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return super().forward(x) + (self.noise if self.training else 0.0)


own = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("module", "text"),
    [
        (Changed(lambda m, x: m.layer(x) + torch.rand(9)), "uses torch in eval mode"),
        (Changed(lambda m, x: m.layer(x) + random.random()), "uses random in eval mode"),
        (
            Changed(lambda m, x: m.layer(x) + (m.training and np.random.rand())),  # noqa: NPY002
            r"uses numpy.random in train\(\) mode; only torch's generator is allowed",
        ),
        (Changed(lambda m, x: m.layer(x) + m.own.random()), "unequal Q-values .* in eval mode"),
        (
            Changed(lambda m, x: m.layer(x) + (m.training and m.own.random())),
            r"unequal Q-values for equal observations in train\(\) mode",
        ),
        (Changed(remembering), "must remember nothing of earlier calls"),
        (Changed(following), "changes its buffer 'seen' in eval mode"),
        (Changed(lambda m, x: m.layer(x.div_(2))), "changes its input in place"),
        (Changed(lambda m, x: m.layer(x) - m.layer(x).mean()), "alone than in a batch in eval"),
        (DrawsElsewhere(random.random), "draw_noise uses random; only rng"),
        (DrawsElsewhere(lambda: float(torch.rand(()))), "draw_noise uses torch; only rng"),
        (DrawsElsewhere(own.random), "draw_noise draws unequal noise from equal generators"),
    ],
)
def test_a_network_that_depends_on_more_than_its_input_is_refused(
    module: nn.Module, text: str
) -> None:
    network = Foreign(module=module)
    with pytest.raises(ConfigError, match="network 'foreign'.*" + text):
        check_contract(network, LAYOUT)


def layers(*inner: nn.Module) -> nn.Module:
    return nn.Sequential(nn.Linear(LAYOUT.size, 32), *inner, nn.Linear(32, ACTIONS))


class Normalised(nn.BatchNorm1d):
    """Uses its statistics for a single row, for which torch's layer has none."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        alone = self.training and len(x) == 1
        return self.eval()(x) if alone else super().forward(x)


@pytest.mark.parametrize("inner", [nn.Dropout(0.5), nn.RReLU(), Normalised(32)], ids=str)
def test_what_differs_in_training_acts_in_the_loss_alone_and_repeats(inner: nn.Module) -> None:
    module = layers(inner)
    network = Foreign(module=module)
    check_contract(network, LAYOUT)
    found = []
    for state in (1, 2):  # of the user's own generator
        agent = learner(copy.deepcopy(module))
        torch.manual_seed(state)
        before = torch.get_rng_state()
        agent.update(fixed_batch(), 0.0)
        if state == 2:  # resumed
            saved, steps = agent.tensors(), agent.optimiser.steps
            agent = learner(copy.deepcopy(module))
            agent.restore(saved, steps)
        found.append((agent.update(fixed_batch(), 0.0), join(agent.tensors())))
        assert torch.equal(torch.get_rng_state(), before)
        assert not agent.target.training
        assert not agent.online.training
    (loss, tensors), (again, others) = found
    assert loss == again
    assert all(torch.equal(tensor, others[name]) for name, tensor in tensors.items())


def learner(module: nn.Module) -> DoubleQ:
    return DoubleQ(Foreign(module=module), LAYOUT, D3qn(), seed=0)


# In the learner


def not_a_number() -> nn.Module:
    layer = nn.Linear(LAYOUT.size, ACTIONS)
    nn.init.constant_(layer.bias, torch.nan)
    return layer


class Odd(nn.Linear):
    """Returns one quantile for each action, without the dimension of the quantiles."""

    def quantiles(self, observation: torch.Tensor) -> torch.Tensor:
        return self(observation)


@pytest.mark.parametrize(
    ("module", "text"),
    [
        (nn.Linear(LAYOUT.size, 4), r"must give Q-values \(2, 9\), .*; the output is \(2, 4\)"),
        (nn.Linear(5, 9), rf"fails on \(2, {LAYOUT.size}\) in train\(\) mode"),
        (nn.LSTM(LAYOUT.size, 9), "the output is a tuple"),
        (len, "must return a torch module; got builtin_function_or_method"),
        (not_a_number(), "finite"),
        (Odd(LAYOUT.size, 9), r"must give quantiles \(2, 9, K\); they are \(2, 9\) of"),
        (
            nn.Linear(LAYOUT.size, 9).requires_grad_(False),
            "build built a network without trainable param",
        ),
        (
            nn.Sequential(nn.BatchNorm1d(LAYOUT.size), nn.Linear(LAYOUT.size, 9)),
            r"fails on \(1, \d+\) in train\(\) mode: forward raised"
            r" ValueError: Expected more than 1 value per channel .*learners\.py:\d+\)",
        ),
    ],
    ids=lambda value: "" if isinstance(value, str) else type(value).__name__,
)
def test_a_network_that_does_not_fit_is_named(module: Any, text: str) -> None:
    with pytest.raises(ConfigError, match="network 'foreign'.*" + text):
        DoubleQ(Foreign(module=module), LAYOUT, D3qn(), seed=0)


class Counted(nn.Module):
    """Holds statistics and a counter that change in training."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(LAYOUT.size, 9)
        self.register_buffer("mean", torch.zeros(LAYOUT.size))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))
        self.register_buffer("scratch", torch.zeros(LAYOUT.size), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if self.training and torch.is_grad_enabled():
            self.mean += 1.0
            self.count += 1
            self.scratch += 1.0
        return self.layer(x - 0.01 * self.mean)


def test_the_target_s_statistics_follow_as_its_weights_do() -> None:
    module = Counted()
    settings = D3qn(target_rate=0.25, updates_together=1)
    agent = DoubleQ(Foreign(module=module), LAYOUT, settings, seed=0)
    assert float(agent.target.get_buffer("mean")[0]) == 0.0  # building it changed nothing
    for _ in range(2):
        agent.update(fixed_batch(), 0.0)
    # Online 1, then 2: the target has 0.25 · 1, then 0.25 + 0.25 · (2 − 0.25).
    assert float(agent.online.get_buffer("mean")[0]) == 2.0
    assert float(agent.target.get_buffer("mean")[0]) == 0.6875
    assert int(agent.target.get_buffer("count")) == 2
    assert float(agent.target.get_buffer("scratch")[0]) == 0.0  # it is not persistent


def test_a_network_with_a_wrong_number_of_frames_is_named() -> None:
    for frames in (0, 33):
        with pytest.raises(ConfigError, match=f"frames is {frames}; 1 to 32 is allowed"):
            DoubleQ(Foreign(module=None, window=frames), LAYOUT, D3qn(), seed=0)
