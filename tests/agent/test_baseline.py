"""The privileged baseline: it takes from the values what only the simulation can tell."""

import dataclasses

import pytest
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.replay import Batch
from flipperctl.api import Network
from flipperctl.config import Agent, resolver
from tests.agent.learners import ACTIONS, LAYOUT, fixed_batch

UNSEEN = 2.0
"""Size of what moves all values of a state alike and is not in its observation."""


def agent(network: str = "dueling_mlp", privileged: int = 1) -> D3qn:
    built = resolver.create("network", network, "network")
    assert isinstance(built, Network)
    return D3qn(built, LAYOUT, ACTIONS, Agent(reward_scale=1.0), seed=0, privileged=privileged)


def batch(size: int = 256) -> Batch:
    """Return decisions whose reward is the unseen number plus a tenth of the action's index."""
    made = fixed_batch(size)
    unseen = torch.randn(size, 1, generator=torch.Generator().manual_seed(1))
    return dataclasses.replace(
        made,
        observation=torch.zeros_like(made.observation),
        reward=UNSEEN * unseen[:, 0] + 0.1 * made.action,
        discount=torch.zeros(size),
        privileged=unseen,
        next_privileged=unseen,
    )


def differences(learner: D3qn) -> torch.Tensor:
    """Return the values of the acting network minus that of action 0, (9,)."""
    with torch.no_grad():
        values = learner.online(torch.zeros(1, LAYOUT.size))[0]
    return values - values[0]


def test_small_differences_are_learnt_beneath_a_large_unseen_change() -> None:
    true = 0.1 * torch.arange(ACTIONS)
    errors, made = {}, batch()
    for privileged in (0, 1):
        learner = agent(privileged=privileged)
        for step in range(200):
            learner.update(made, step / 200)
        errors[privileged] = float((differences(learner) - true).abs().max())
    assert errors[1] < 0.1 < errors[0], errors


def test_the_next_state_s_baseline_is_discounted_into_the_target() -> None:
    learner = agent()
    assert learner.baselines is not None
    target = learner.baselines.target.layers[-1]
    assert isinstance(target, torch.nn.Linear)
    target.weight.data.zero_()
    target.bias.data.fill_(3.0)
    made = dataclasses.replace(batch(2), discount=torch.tensor([0.5, 0.0]))
    targets = torch.tensor([1.0, 1.0])
    assert learner.baselines.with_next(targets, made).tolist() == pytest.approx([2.5, 1.0])
    quantiles = learner.baselines.with_next(torch.ones(2, 4), made)
    assert quantiles.tolist() == [[2.5] * 4, [1.0] * 4]


@pytest.mark.parametrize("network", ["at_d3qn", "quantile"])
def test_an_update_moves_the_baseline_and_its_target_follows(network: str) -> None:
    learner = agent(network)
    assert learner.baselines is not None
    before = [p.detach().clone() for p in learner.baselines.parameters()]
    learner.update(batch(), 0.0)
    now = list(learner.baselines.parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, now, strict=True))


def test_the_policy_holds_no_part_of_the_baseline() -> None:
    learner = agent()
    assert learner.policy.state_dict().keys() == agent(privileged=0).policy.state_dict().keys()
    assert any(name.startswith("baselines.") for name in learner.tensors())
