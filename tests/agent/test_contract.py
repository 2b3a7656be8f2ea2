"""What a network's Q-values may depend on: their input, the weights, and in the loss on torch."""

import copy
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from flipperctl.agent.contract import check_contract
from flipperctl.agent.d3qn import D3qn
from flipperctl.config import Agent
from flipperctl.errors import ConfigError
from flipperctl.policies.exploring import ExploringPolicy
from tests.agent.learners import ACTIONS, LAYOUT, Foreign, fixed_batch


class Changed(nn.Module):
    """A linear layer whose forward is a function of the module and its input."""

    def __init__(self, forward: Callable[[Any, torch.Tensor], torch.Tensor]) -> None:
        super().__init__()
        self.layer, self.change = nn.Linear(18, ACTIONS), forward
        self.cell, self.kept = nn.GRUCell(18, 18), torch.zeros(1, 18)
        self.register_buffer("seen", torch.zeros(18))
        self.own = np.random.default_rng(0)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.change(self, x)


def remembering(m: Any, x: torch.Tensor) -> torch.Tensor:
    kept = m.kept if len(m.kept) == len(x) else torch.zeros(len(x), 18)
    m.kept = m.cell(x, kept).detach()
    return m.layer(m.kept)


def following(m: Any, x: torch.Tensor) -> torch.Tensor:
    m.seen.lerp_(x.mean(dim=0), 0.1)
    return m.layer(x)


class DrawsElsewhere(nn.Linear):
    """Its noise comes from another generator than ``rng``."""

    def __init__(self, draw: Callable[[], float]) -> None:
        super().__init__(18, ACTIONS)
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
    return nn.Sequential(nn.Linear(18, 32), *inner, nn.Linear(32, ACTIONS))


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
        found.append((agent.update(fixed_batch(), 0.0), agent.tensors()))
        assert torch.equal(torch.get_rng_state(), before)
        assert not agent.target.training
        assert not agent.online.training
    (loss, tensors), (again, others) = found
    assert loss == again
    assert all(torch.equal(tensor, others[name]) for name, tensor in tensors.items())


def learner(module: nn.Module) -> D3qn:
    return D3qn(Foreign(module=module), LAYOUT, ACTIONS, Agent(), seed=0)


def test_computing_targets_moves_no_statistics() -> None:
    agent = learner(layers(Normalised(32)))
    batch = fixed_batch()
    kept = {name: b.clone() for name, b in agent.target.named_buffers()}
    agent._head.targets(batch.reward, batch, agent.online, agent.target)
    for module in (agent.online, agent.target):
        assert all(torch.equal(b, kept[name]) for name, b in module.named_buffers())


def test_decisions_of_training_drop_no_units() -> None:
    agent = learner(layers(nn.Dropout(0.5)))
    agent.online.train()
    rng = np.random.default_rng(0)
    ExploringPolicy(agent.online, 1, lambda: 0.0, rng, rng).reset(None)  # type: ignore[arg-type]
    row = torch.randn(1, 18)
    assert torch.equal(agent.online(row), agent.online(row))
