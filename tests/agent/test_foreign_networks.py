"""Networks of plugins in the learner: one that does not fit is named."""

from typing import Any

import pytest
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.config import Agent
from flipperctl.errors import ConfigError
from tests.agent.learners import ACTIONS, LAYOUT, Foreign, fixed_batch


def not_a_number() -> torch.nn.Module:
    layer = torch.nn.Linear(LAYOUT.size, ACTIONS)
    torch.nn.init.constant_(layer.bias, torch.nan)
    return layer


class Odd(torch.nn.Linear):
    """Returns one quantile for each action, without the dimension of the quantiles."""

    def quantiles(self, observation: torch.Tensor) -> torch.Tensor:
        return self(observation)


@pytest.mark.parametrize(
    ("module", "text"),
    [
        (torch.nn.Linear(18, 4), r"must give Q-values \(2, 9\); the output is \(2, 4\)"),
        (torch.nn.Sequential(torch.nn.Linear(18, 9), torch.nn.Flatten(0)), r"output is \(18,\)"),
        (torch.nn.Linear(5, 9), r"fails on observations of shape \(2, 18\)"),
        (torch.nn.LSTM(18, 9), "the output is tuple"),
        (len, "must return a torch module; got builtin_function_or_method"),
        (not_a_number(), "finite"),
        (Odd(18, 9), r"must give quantiles \(2, 9, K\); they are \(2, 9\)"),
    ],
    ids=["too few actions", "flat", "too few inputs", "tuple", "no module", "nan", "quantiles"],
)
def test_a_network_that_does_not_fit_is_named(module: Any, text: str) -> None:
    with pytest.raises(ConfigError, match="network 'foreign'.*" + text):
        D3qn(Foreign(module=module), LAYOUT, ACTIONS, Agent(), seed=0)


def normalised() -> torch.nn.Module:
    """Return a network with running statistics, which needs a batch in ``train()`` mode."""
    return torch.nn.Sequential(torch.nn.BatchNorm1d(18), torch.nn.Linear(18, 9))


class Counted(torch.nn.Module):
    """Holds statistics and a counter that change in training."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(18, 9)
        self.register_buffer("mean", torch.zeros(18))
        self.register_buffer("count", torch.zeros((), dtype=torch.int64))
        self.register_buffer("scratch", torch.zeros(18), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if self.training and torch.is_grad_enabled():
            self.mean += 1.0
            self.count += 1
            self.scratch += 1.0
        return self.layer(x - 0.01 * self.mean)


def test_a_network_that_needs_a_batch_is_refused_before_it_acts() -> None:
    expected = (
        r"network 'foreign' fails on one observation in train\(\) mode, which training episodes "
        r"use: forward raised ValueError: Expected more than 1 value per channel "
        r".*learners\.py:\d+\)"
    )
    with pytest.raises(ConfigError, match=expected):
        D3qn(Foreign(module=normalised()), LAYOUT, ACTIONS, Agent(), seed=0)


def test_the_target_s_statistics_follow_as_its_weights_do() -> None:
    module = Counted()
    settings = Agent(target_rate=0.25, updates_together=1)
    agent = D3qn(Foreign(module=module), LAYOUT, ACTIONS, settings, seed=0)
    assert float(agent.target.get_buffer("mean")[0]) == 0.0  # building it changed nothing
    for _ in range(2):
        agent.update(fixed_batch(), 0.0)
    # Online 1, then 2: the target has 0.25 · 1, then 0.25 + 0.25 · (2 − 0.25).
    assert float(agent.online.get_buffer("mean")[0]) == 2.0
    assert float(agent.target.get_buffer("mean")[0]) == 0.6875
    assert int(agent.target.get_buffer("count")) == 2
    assert (
        float(agent.target.get_buffer("scratch")[0]) == 0.0
    )  # buffers that are not persistent are not copied


def test_a_network_without_anything_to_learn_is_refused() -> None:
    frozen = torch.nn.Linear(18, 9).requires_grad_(False)
    with pytest.raises(ConfigError, match="build built a network without trainable parameters"):
        D3qn(Foreign(module=frozen), LAYOUT, ACTIONS, Agent(), seed=0)


def test_a_network_with_a_wrong_number_of_frames_is_named() -> None:
    for frames in (0, 33):
        with pytest.raises(ConfigError, match=f"frames is {frames}; 1 to 32 is allowed"):
            D3qn(Foreign(module=None, window=frames), LAYOUT, ACTIONS, Agent(), seed=0)
