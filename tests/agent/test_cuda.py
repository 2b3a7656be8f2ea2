"""The learners on a graphics card: what the CPU computes, and runs that move between both."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import learner as bench_learner
from flipperctl import checkpoint
from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.learner import Learner
from flipperctl.agent.policy_gradient import PolicyGradient
from flipperctl.agent.replay import Batch
from flipperctl.api import Network
from flipperctl.config import Agent, Teacher, resolver
from flipperctl.core.risk import LAGS
from tests.benchmarks.small import check, small_benchmark
from tests.short import short_config, trainer

from .learners import ACTIONS, LAYOUT

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")

ROWS = 64


def network() -> Network:
    built = resolver.create("network", "at_d3qn", "network")
    assert isinstance(built, Network)
    return built


def batch() -> Batch:
    """Transitions with labels, privileged states and failures."""
    rng = np.random.default_rng(0)

    def draw(*shape: int) -> torch.Tensor:
        return torch.from_numpy(rng.normal(0, 0.3, shape).astype(np.float32))

    return Batch(
        observation=draw(ROWS, LAYOUT.size),
        action=torch.arange(ROWS) % ACTIONS,
        reward=draw(ROWS),
        next_observation=draw(ROWS, LAYOUT.size),
        discount=torch.full((ROWS,), 0.5),
        label=torch.softmax(draw(ROWS, ACTIONS), dim=1),
        privileged=draw(ROWS, 2),
        next_privileged=draw(ROWS, 2),
        failing=(torch.arange(ROWS) % 3 == 0).float(),
        resembles=draw(ROWS, len(LAGS)),
    )


def values(device: str) -> D3qn:
    """A learner of values with a teacher and a risk."""
    agent, teacher = Agent(risk=True, batch_size=ROWS), Teacher(controller={"name": "okada"})
    return D3qn(network(), LAYOUT, agent, seed=0, device=device, teacher=teacher)


def gradient(device: str) -> PolicyGradient:
    """A learner by the policy gradient with an anchor and a risk."""
    own = {"warm_up": 0, "anchor": 0.01}
    agent = Agent(
        learner="policy_gradient", n_step=1, risk=True, batch_size=ROWS, policy_gradient=own
    )
    return PolicyGradient(network(), LAYOUT, agent, seed=0, device=device, privileged=2)


@pytest.mark.parametrize("create", [values, gradient])
def test_its_updates_are_those_of_the_cpu(create: Callable[[str], Learner]) -> None:
    after = []
    for device in ("cpu", "cuda"):
        made = create(device)
        for _ in range(3):
            if isinstance(made, PolicyGradient):
                made.update(batch(), 0.0, np.random.default_rng(1))
            else:
                assert isinstance(made, D3qn)
                made.update(batch(), 0.0)
        assert {tensor.device.type for tensor in made.online.state_dict().values()} == {device}
        after.append(made.policy_arrays())
    here, there = after
    assert here.keys() == there.keys()
    for name, weights in here.items():
        np.testing.assert_allclose(there[name], weights, atol=1e-4, err_msg=name)


@pytest.mark.parametrize(("first", "then"), [("cuda", "cpu"), ("cpu", "cuda"), ("cuda", "cuda")])
def test_a_run_continues_on_either_device(first: str, then: str, tmp_path: Path) -> None:
    more = {"agent.risk": True}
    stopped = trainer(short_config(device=first, **more), tmp_path)
    stopped.run(lambda: stopped.progress.decision >= 350)
    again = trainer(short_config(device=then, **more), tmp_path)
    again.restore(checkpoint.read(tmp_path / checkpoint.LAST))
    assert again.run()["finished"]
    assert checkpoint.read(tmp_path / checkpoint.BEST).part("policy")


def test_its_updates_are_measured_beside_those_of_the_cpu() -> None:
    bench = small_benchmark(batch_sizes=(16,))
    found = bench_learner.measure(
        type(bench)(bench.config.model_copy(update={"device": "cuda"}), bench.settings)
    )
    check(found)
    assert [*found["weights"]] == ["flipperctl", "flipperctl on cuda"]
    assert [*found["ratios"]] == ["flipperctl on cuda / flipperctl, batches of 16"]
