"""Updates of both learners."""

import sys

import numpy as np
import pytest
import torch

from benchmarks import updates
from flipperctl.agent.d3qn import D3qn
from flipperctl.bench import learner
from tests.bench.small import check
from tests.benchmarks.small import small_benchmark


def test_both_replays_hold_the_same() -> None:
    sb3 = pytest.importorskip("benchmarks.sb3")
    config = small_benchmark().config
    replay = learner.fill(config, 120, 0)
    model = sb3.model(config, 1, n_steps=1, net_arch=(8,))
    sb3.fill(model, replay)
    held, buffer = replay.filled(), model.replay_buffer
    assert buffer.size() == 120
    assert np.array_equal(buffer.observations[:120, 0], held["observation"])
    assert np.array_equal(buffer.rewards[:120, 0], held["reward"])
    ends = np.flatnonzero(buffer.dones[:120, 0])
    assert len(ends) > 0
    assert np.array_equal(ends, np.flatnonzero(held["discount"] == 0))


def test_an_update_of_theirs_moves_both_networks() -> None:
    sb3 = pytest.importorskip("benchmarks.sb3")
    config = small_benchmark().config
    model = sb3.model(config, 1, n_steps=1, net_arch=(8,))
    sb3.fill(model, learner.fill(config, 120, 0))
    before = [p.clone() for p in model.q_net_target.parameters()]
    sb3.updater(model, 32)()
    for old, target, online in zip(
        before, model.q_net_target.parameters(), model.q_net.parameters(), strict=True
    ):
        mixed = (1 - model.tau) * old + model.tau * online
        assert torch.allclose(target, mixed, atol=1e-7)
        assert not torch.equal(target, old)


@pytest.mark.parametrize(("network", "layers"), [("at_d3qn", 4), ("dueling_mlp", 3), ("mlp", 2)])
def test_the_depth_of_a_network(network: str, layers: int) -> None:
    config = small_benchmark().config.model_copy(update={})
    config = type(config)(terrain="step", network=network)
    agent = D3qn(config.network, config.perception, 9, config.agent, seed=1)
    assert updates.hidden_layers(agent.online, 18) == layers


def test_the_width_of_a_perceptron_of_equal_size() -> None:
    # 18→122→122→122→122→9: 19·122 + 3·123·122 + 123·9 = 48,443; one narrower is 47,683.
    assert updates.equal_width(48_443, 18, 9, 4) == 122
    assert updates.equal_width(48_000, 18, 9, 4) == 121
    assert updates.equal_width(1, 18, 9, 4) == 1


def test_without_sb3_our_side_is_measured_and_the_extra_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    found = updates.measure(small_benchmark())
    check(found)
    assert found["missing"] == ["stable-baselines3 is not installed; install flipperctl[bench]"]
    assert set(found["quantities"]) == {"flipperctl.updates.32", "flipperctl.transitions.32"}
    assert found["ratios"] == {}
