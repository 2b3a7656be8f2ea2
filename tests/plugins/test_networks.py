"""The modules of the built-in networks against numbers worked by hand."""

import numpy as np
import pytest
import torch
from flipperctl_plugins.networks.modules import Dropout, Motion, NoisyLinear, Normalise

from flipperctl.api import Network, ObservationLayout
from flipperctl.config import resolver
from flipperctl.errors import ConfigError
from flipperctl.export.policy import folded

LAYOUT = ObservationLayout()


def build(name: str, **fields: object) -> torch.nn.Module:
    network = resolver.create("network", {"name": name, **fields}, "network")
    assert isinstance(network, Network)
    torch.manual_seed(0)
    return network.build(LAYOUT, 9)


def test_the_noise_is_factorised_and_absent_in_eval_mode() -> None:
    layer = NoisyLinear(2, 1, sigma=0.5)
    for parameter, value in zip(layer.mean.parameters(), ([[1.0, 2.0]], [3.0]), strict=True):
        parameter.data = torch.tensor(value)
    assert layer.sigma.weight.tolist()[0] == pytest.approx([0.5 / 2**0.5] * 2)  # σ₀ / √inputs
    layer.sigma.weight.data = torch.tensor([[0.1, 0.2]])
    layer.sigma.bias.data = torch.tensor([0.3])
    layer.noise_in.copy_(torch.tensor([1.0, -1.0]))
    layer.noise_out.copy_(torch.tensor([2.0]))
    row = torch.tensor([[10.0, 20.0]])
    # (1 + 0.1 · 2 · 1) · 10 + (2 + 0.2 · 2 · -1) · 20 + 3 + 0.3 · 2
    assert layer(row).item() == pytest.approx(47.6)
    assert layer.eval()(row).item() == pytest.approx(53.0)


def test_noise_comes_from_the_generator_and_is_not_a_weight() -> None:
    layer, other = NoisyLinear(400, 3), NoisyLinear(400, 3)
    layer.draw_noise(np.random.default_rng(1))
    other.draw_noise(np.random.default_rng(1))
    assert torch.equal(layer.noise_in, other.noise_in)
    assert set(layer.state_dict()) == set(dict(layer.named_parameters()))
    # f(ε) = sign(ε) √|ε| of a standard normal ε: E f² = E |ε| = √(2/π) = 0.80
    assert layer.noise_in.square().mean().item() == pytest.approx(0.80, abs=0.1)
    assert layer.noise_in.mean().item() == pytest.approx(0.0, abs=0.15)


def test_dropout_acts_where_gradients_are_recorded_alone() -> None:
    layer, ones = Dropout(0.25), torch.ones(100, 100)
    layer.draw_noise(np.random.default_rng(1))
    first = layer(ones)
    assert first.unique().tolist() == pytest.approx([0.0, 1 / 0.75])
    assert (first == 0).float().mean().item() == pytest.approx(0.25, abs=0.02)
    assert torch.equal(layer(ones), first)
    layer.draw_noise(np.random.default_rng(2))
    assert not torch.equal(layer(ones), first)
    with torch.inference_mode():  # as a decision of training is made
        assert torch.equal(layer(ones), ones)
    assert torch.equal(layer.eval()(ones), ones)


def test_motion_is_the_newest_frame_and_the_changes_up_to_it() -> None:
    rows = torch.tensor([[1.0, 5.0, 2.0, 4.0, 4.0, 0.0]])  # (1, 5), then (2, 4), then (4, 0)
    for found in (Motion([0, 1, 2], 3, 2), Motion([0, 1, 2], 3, 2).folded()):
        assert found(rows).tolist() == [[4.0, 0.0, 1.0, -1.0, 2.0, -4.0]]
    for found in (Motion([0, 2], 3, 2), Motion([0, 2], 3, 2).folded()):
        assert found(rows).tolist() == [[4.0, 0.0, 3.0, -5.0]]


def test_earlier_observations_are_seen_and_those_between_are_not() -> None:
    module = build("stacked", window=2, earlier=(3, 6)).eval()
    rows = torch.randn(1, 7 * LAYOUT.size)
    before = module(rows)
    for frame in range(7):
        changed = rows.clone()
        changed[:, frame * LAYOUT.size : (frame + 1) * LAYOUT.size] += 0.1
        assert torch.equal(module(changed), before) == (6 - frame not in (0, 1, 3, 6))


def test_quantiles_differ_and_their_mean_is_the_q_value() -> None:
    module = build("quantile", quantiles=5)
    observation = torch.randn(3, LAYOUT.size)
    quantiles = module.quantiles(observation)
    assert quantiles.shape == (3, 9, 5)
    assert quantiles.std(dim=2).min() > 0
    assert torch.allclose(quantiles.mean(dim=2), module(observation))


def test_the_convolution_continues_the_ground_beyond_its_ends() -> None:
    module = build("conv", channels=(3, 2), reach=2)
    flat = torch.zeros(1, LAYOUT.size)
    flat[:, : LAYOUT.heights] = 0.3  # level ground gives equal features in every bin
    features = module[1].terrain(flat[:, : LAYOUT.heights]).reshape(2, LAYOUT.bins)
    assert torch.allclose(features, features[:, :1].expand(-1, LAYOUT.bins), atol=1e-6)


def test_a_layer_of_zero_width_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"network\.channels\.0: 0 is not allowed \(> 0\)"):
        build("conv", channels=(0,))


@pytest.mark.parametrize("name", ["at_d3qn", "conv", "dueling_mlp", "stacked"])
def test_folded_heads_give_the_same_values_in_fewer_layers(name: str) -> None:
    module = build(name, **({"dropout": 0.1} if name == "stacked" else {})).eval()
    inputs = LAYOUT.size * (3 if name == "stacked" else 1)
    observation = torch.randn(5, inputs)
    before = {key: value.clone() for key, value in module.state_dict().items()}
    found = folded(module)
    assert torch.allclose(found(observation), module(observation), atol=1e-5)
    layers = [sum(isinstance(m, torch.nn.Linear) for m in n.modules()) for n in (module, found)]
    assert layers[1] == layers[0] - 2 + (name == "stacked")  # whose frames are one layer, too
    if name == "stacked":
        assert not any(isinstance(m, Normalise) for m in found.modules())
    assert all(torch.equal(before[key], value) for key, value in module.state_dict().items())


def test_noisy_heads_stay_as_they_are() -> None:
    module = build("noisy").eval()
    observation = torch.randn(5, LAYOUT.size)
    assert torch.equal(folded(module)(observation), module(observation))
