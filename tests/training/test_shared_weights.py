"""Networks whose weights have two names, are frozen, or share memory: trained, saved and loaded."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from torch import nn

from flipperctl import api, checkpoint
from flipperctl.errors import ConfigError
from flipperctl.policies.trained import policy_module
from flipperctl.testing import checks
from tests.short import short_config, trainer

Change = Callable[["Net"], object]


class Net(nn.Module):
    """Two layers, and a factor of the Q-values."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(inputs, 16), nn.Linear(16, 16)
        self.last = nn.Linear(16, outputs)
        self.register_buffer("factor", torch.ones(()))

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        hidden = torch.tanh(self.first(rows)).to(self.second.weight.dtype)
        return self.last(torch.tanh(self.second(hidden)).float()) * self.factor


def alias(net: Net) -> None:
    net.head = net.last


def tie(net: Net) -> None:
    net.first = nn.Sequential(net.first, nn.Linear(16, 16))
    net.first[1].weight = net.second.weight


def freeze(net: Net) -> None:
    net.first.requires_grad_(False)
    net.second.bias.requires_grad_(False)


def expand_buffer(net: Net) -> None:
    net.register_buffer("factor", torch.tensor(0.5).expand(9))


def expand_parameter(net: Net) -> None:
    net.second.bias = nn.Parameter(torch.tensor(0.5).expand(16))


def cut(net: Net) -> None:
    memory = torch.randn(16, 33) / 8
    net.second.weight = nn.Parameter(memory[:, :32:2])
    net.second.bias = nn.Parameter(memory[:, 32])


def network(change: Change) -> api.Network:
    @api.network("mine")
    class Mine(api.Network):
        """A network that a test changes."""

        def build(self, layout: api.ObservationLayout, n_actions: int) -> nn.Module:
            net = Net(layout.size, n_actions)
            change(net)
            return net

    return Mine()


def run(change: Change, folder: Path, learner: str) -> nn.Module:
    """Train 40 decisions and return the trained policy as its file holds it."""
    own = {"d3qn": {"learning_starts": 8, "n_step": 1}, "policy_gradient": {"decisions": 2}}
    agent = {"name": learner, "batch_size": 8, **own[learner]}
    agent |= {"warm_up": 0} if learner == "policy_gradient" else {}
    short = {"train.decisions": 40, "train.validation_episodes": 1}
    config = short_config(**short, agent=agent, network=network(change), terrain="flat")
    made = trainer(config, folder)
    made.run()
    assert made.progress.updates
    return policy_module(checkpoint.read(folder / checkpoint.LAST))


@pytest.mark.parametrize("change", [alias, tie, freeze, expand_buffer, expand_parameter])
@pytest.mark.usefixtures("registry")
def test_what_the_suite_approves_trains(change: Change) -> None:
    for check in checks(type(network(change))):
        if check.name in ("shape", "gradient", "trains"):
            check()


@pytest.mark.usefixtures("registry")
def test_a_weight_with_two_names_is_written_once(tmp_path: Path) -> None:
    policy = run(alias, tmp_path, "policy_gradient")
    assert policy.head.weight is policy.last.weight
    with safe_open(tmp_path / checkpoint.LAST, "pt") as file:
        names = [name for name in file.keys() if name.startswith("target.")]  # noqa: SIM118
    assert sum(name.endswith(("head.weight", "last.weight")) for name in names) == 1


@pytest.mark.parametrize("learner", ["d3qn", "policy_gradient"])
@pytest.mark.usefixtures("registry")
def test_frozen_weights_stay(learner: str, tmp_path: Path) -> None:
    started: list[nn.Module] = []

    def keep(net: Net) -> None:
        freeze(net)
        started.append({name: weight.clone() for name, weight in net.state_dict().items()})

    policy = run(keep, tmp_path, learner)
    begun = started[1]  # the first one only measured the demand for memory
    same = {name: torch.equal(weight, begun[name]) for name, weight in policy.named_parameters()}
    assert [name for name, equal in same.items() if equal] == [
        "first.weight",
        "first.bias",
        "second.bias",
    ]


@pytest.mark.parametrize(
    "change",
    [
        lambda net: net.register_buffer("view", net.second.weight.detach().t()),
        lambda net: net.register_parameter("part", nn.Parameter(net.second.weight[3:5, ::2])),
        cut,
    ],
)
@pytest.mark.usefixtures("registry")
def test_two_tensors_of_one_memory_are_refused_by_name(change: Change, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"second\.weight.* the same memory; to tie weights"):
        run(change, tmp_path, "d3qn")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda net: net.second.double(), r"'second.weight' as torch.float64; float32 is allowed"),
        (lambda net: net.register_buffer("wave", torch.ones(2) * 1j), "'wave' as torch.complex64"),
        (
            lambda net: net.register_buffer("short", torch.ones(2).bfloat16()),
            "'short' as torch.bfloat16",
        ),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_state_that_cannot_be_trained_and_saved_is_refused(
    change: Change, text: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=text):
        run(change, tmp_path, "d3qn")
