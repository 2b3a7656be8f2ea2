"""The learners on a graphics card: what the CPU computes, and runs that move between both."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.risk import weights_of
from flipperctl.api import Network
from flipperctl.config import Teacher, resolver
from flipperctl.core.risk import LAGS
from flipperctl.learners import D3qn, PolicyGradient
from flipperctl.learners.clipped import ClippedGradient
from flipperctl.learners.double_q import DoubleQ
from flipperctl.learners.pair import NetworkPair
from tests.short import short_config, trainer

from .learners import ACTIONS, LAYOUT, fixed_batch

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")


def learners(device: str) -> Iterator[NetworkPair]:
    """Yield one of values with a teacher, and one by the policy gradient with an anchor."""
    network = resolver.create("network", "at_d3qn", "network")
    assert isinstance(network, Network)
    agent, teacher = D3qn(risk=True, batch_size=64), Teacher(controller={"name": "okada"})
    yield DoubleQ(network, LAYOUT, agent, seed=0, device=device, teacher=teacher)
    gradient = PolicyGradient(
        warm_up=0, anchor=0.01, risk=True, batch_size=64, decisions=64, replay_size=128
    )
    yield ClippedGradient(network, LAYOUT, gradient, seed=0, device=device, privileged=2)


def test_its_updates_are_those_of_the_cpu() -> None:
    draws = torch.Generator().manual_seed(0)
    batch = replace(
        fixed_batch(64),
        label=torch.softmax(torch.randn(64, ACTIONS, generator=draws), dim=1),
        privileged=torch.randn(64, 2, generator=draws),
        next_privileged=torch.randn(64, 2, generator=draws),
        failing=(torch.arange(64) % 3 == 0).float(),
        resembles=torch.randn(64, len(LAGS), generator=draws),
    )
    for here, there in zip(learners("cpu"), learners("cuda"), strict=True):
        for made in (here, there):
            for _ in range(3):
                if isinstance(made, ClippedGradient):
                    made.update(batch, 0.0, np.random.default_rng(1))
                else:
                    assert isinstance(made, DoubleQ)
                    made.update(batch, 0.0)
        assert {tensor.device.type for tensor in there.online.state_dict().values()} == {"cuda"}
        found = weights_of(there.policy)
        for name, weights in weights_of(here.policy).items():
            np.testing.assert_allclose(found[name], weights, atol=1e-4, err_msg=name)


@pytest.mark.parametrize(("first", "then"), [("cuda", "cpu"), ("cpu", "cuda")])
def test_a_run_continues_on_either_device(first: str, then: str, tmp_path: Path) -> None:
    more = {"agent.risk": True}
    stopped = trainer(short_config(device=first, **more), tmp_path)
    stopped.run(lambda: stopped.progress.decision >= 350)
    again = trainer(short_config(device=then, **more), tmp_path)
    again.restore(checkpoint.read(tmp_path / checkpoint.LAST))
    assert again.run()["finished"]
    assert checkpoint.read(tmp_path / checkpoint.BEST).part("policy")
