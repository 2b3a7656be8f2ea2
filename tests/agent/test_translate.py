"""What workers drive with: networks as numpy computes them, beside torch's."""

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from flipperctl.agent.contract import observations
from flipperctl.agent.networks import TorchNetwork, build_policy
from flipperctl.agent.plain import PlainNetwork, PlainRisk
from flipperctl.agent.risk import RiskNetwork, plain_risk, weights_of
from flipperctl.agent.translate import translated
from flipperctl.api import Network, ObservationLayout
from flipperctl.api.plugin import registered_names
from flipperctl.config import resolver
from flipperctl.errors import NonFiniteError
from flipperctl.policies.acting import ExploringPolicy, best

LAYOUT = ObservationLayout()
SIZE = LAYOUT.size


class Own(Network):
    """A network of somebody else's package."""

    def build(self, layout: ObservationLayout, n_actions: int) -> nn.Module:
        raise NotImplementedError


def network(name: str, **fields: object) -> Network:
    created = resolver.create("network", {"name": name, **fields}, "network")
    assert isinstance(created, Network)
    return created


def loaded(module: nn.Module, plugin: Network) -> PlainNetwork:
    plain = translated(module, plugin, LAYOUT)
    assert plain is not None
    plain.load(weights_of(module))
    return plain


@pytest.mark.parametrize("kind", ["turns", "rates"])
@pytest.mark.parametrize(
    "plugin",
    [
        *map(network, sorted({*registered_names("network")} - {"conv"})),
        network("stacked", dropout=0.2, earlier=(5, 9)),
        network("mlp", hidden=(7,)),
    ],
    ids=lambda plugin: plugin.plugin_name,
)
def test_numpy_decides_as_torch_does(plugin: Network, kind: Any) -> None:
    torch.manual_seed(1)
    module = build_policy(plugin, LAYOUT, kind).eval()
    plain, reference = loaded(module, plugin), TorchNetwork(module, kind)
    rows = observations(plugin, LAYOUT, 500).numpy()
    values, expected = (np.array([n.outputs(row) for row in rows]) for n in (plain, reference))
    assert np.abs(values - expected).max() < 1e-6 * np.abs(expected).max()
    # Equal choices, but where two values are equal up to rounding
    top = np.sort(expected, axis=1)
    apart = top[:, -1] - top[:, -2] > 1e-5
    assert apart.mean() > 0.99
    assert (values.argmax(axis=1) == expected.argmax(axis=1))[apart].all()
    # Other weights of the same structure, as after an update
    other = build_policy(plugin, LAYOUT, kind).eval()
    plain.load(weights_of(other))
    expected_values = TorchNetwork(other, kind).outputs(rows[0])
    assert plain.outputs(rows[0]) == pytest.approx(expected_values, rel=1e-5, abs=1e-6)


class Branching(nn.Linear):
    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return super().forward(rows) if rows.sum() > 0 else -super().forward(rows)


class Buffered(nn.Linear):
    def __init__(self) -> None:
        super().__init__(SIZE, 9)
        self.register_buffer("offset", torch.ones(9), persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return super().forward(rows) + self.offset


def hooked() -> nn.Module:
    layer = nn.Linear(SIZE, 9)
    layer.register_forward_hook(lambda module, inputs, output: 2 * output)
    return nn.Sequential(layer)


@pytest.mark.parametrize(
    "module",
    [
        Branching(SIZE, 9),
        Buffered(),
        hooked(),
        nn.Sequential(nn.Linear(SIZE, 9), nn.Softsign()),
        nn.Sequential(nn.Flatten(0), nn.Unflatten(0, (-1, SIZE)), nn.LeakyReLU(3.0)),
        build_policy(network("conv"), LAYOUT),
    ],
    ids=["branch", "buffer", "hook", "layer", "slope", "convolution"],
)
def test_what_only_torch_computes_is_left_to_it(module: nn.Module) -> None:
    assert translated(module, Own(), LAYOUT) is None


def test_a_network_of_torch_s_own_layers_needs_nothing_of_its_plugin() -> None:
    module = nn.Sequential(nn.Linear(SIZE, 8), nn.ReLU(), nn.Dropout(0.5), nn.Linear(8, 9, False))
    row = np.linspace(-1, 1, SIZE, dtype=np.float32)
    expected = module.eval()(torch.from_numpy(row)[None]).detach()[0]
    assert loaded(module, Own()).outputs(row) == pytest.approx(expected.tolist(), rel=1e-5)


def test_numbers_worked_by_hand_and_the_error_of_ones_that_are_not_finite() -> None:
    module = nn.Sequential(nn.Linear(SIZE, 2), nn.LeakyReLU(0.5))
    plain = loaded(module, Own())
    weight = np.zeros((2, SIZE), np.float32)
    weight[0, 0], weight[1, 1] = 2, 4
    plain.load({"0.weight": weight, "0.bias": np.array([1, -1], np.float32)})
    row = np.zeros(SIZE, np.float32)
    row[:2] = 3, -1
    assert plain.outputs(row) == [7.0, -2.5]  # 2 · 3 + 1, and half of 4 · -1 - 1
    row[0] = np.nan
    with pytest.raises(NonFiniteError, match=r"a Sequential: forward returned .* not finite"):
        plain.outputs(row)


def test_a_risk_is_that_of_torch() -> None:
    torch.manual_seed(2)
    network = RiskNetwork(SIZE)
    plain = translated(network.layers, Own(), LAYOUT, "layers.")
    assert plain is not None
    risks = PlainRisk(plain, 10), plain_risk(network, 10)
    episodes = [risk.begin(SIZE) for risk in risks]
    for risk in risks:
        risk.load(weights_of(network))
    for row in observations(Own(), LAYOUT, 20).numpy():
        here, there = (r.of_one(row, e) for r, e in zip(risks, episodes, strict=True))
        assert here == pytest.approx(there, rel=1e-5)


def test_an_exploring_policy_draws_the_same_numbers_with_either() -> None:
    plugin = network("at_d3qn")
    module = build_policy(plugin, LAYOUT)
    plain = loaded(module, plugin)
    states = []
    for acts in (module, plain):
        rng = np.random.default_rng(3)
        policy = ExploringPolicy(acts, 1, lambda: 0.5, rng, rng)
        policy.network.begin(noise=True)
        policy.network.draw_noise(rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]
    assert best([1.0, 3.0, 3.0]) == 1


def test_a_translation_is_unpickled_without_torch() -> None:
    plugin = network("stacked", earlier=(4,))
    data = pickle.dumps(translated(build_policy(plugin, LAYOUT), plugin, LAYOUT))
    program = f"import pickle, sys; pickle.loads({data!r}); sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
