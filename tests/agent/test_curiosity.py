"""The curiosity: its reward by hand, what it learns, and what it does not touch."""

import pytest
import torch

from flipperctl.agent.curiosity import Curiosity
from flipperctl.agent.replay import Batch
from flipperctl.errors import ConfigError
from flipperctl.learners import D3qn
from tests.agent.learners import fixed_batch, learner


def test_the_reward_is_half_the_squared_error_of_the_features() -> None:
    made = Curiosity(2, 9, seed=0, device=torch.device("cpu"))
    for module in made.network.modules():
        if isinstance(module, torch.nn.Linear):
            torch.nn.init.zeros_(module.weight)
            torch.nn.init.zeros_(module.bias)
    features, ahead = made.network.features, made.network.ahead
    features[0].weight.data[0, 0] = 1.0  # the first feature: twice the first number, if positive
    features[2].weight.data[0, 0] = 2.0
    ahead[2].bias.data[0] = 1.0  # predicted as 1, whatever is done
    rows = torch.tensor([[0.0, 5.0], [3.0, 0.0], [-1.0, 0.0]])
    batch = Batch(rows, torch.tensor([0, 4, 8]), torch.zeros(3), rows, torch.ones(3))
    assert made.reward(batch).tolist() == [0.5, 12.5, 0.5]


def test_what_is_seen_often_is_no_longer_curious() -> None:
    made = Curiosity(fixed_batch().observation.shape[1], 9, seed=1, device=torch.device("cpu"))
    batch = fixed_batch(9)
    first = float(made.reward(batch).mean())
    losses = [made.step(batch, 1e-3) for _ in range(200)]
    assert losses[-1] < 0.5 * losses[0]
    other = fixed_batch(64).rows(slice(32, 64))
    assert float(made.reward(batch).mean()) < float(made.reward(other).mean())
    assert first > 0


def test_it_changes_the_targets_and_is_saved_but_no_policy_holds_it() -> None:
    plain, curious = learner(n_step=1), learner(n_step=1, curiosity=10.0)
    assert plain.update(fixed_batch(), 0.0) != curious.update(fixed_batch(), 0.0)
    names = curious.tensors().keys() - plain.tensors().keys()
    assert names
    assert all(name.startswith("curiosity") for name in names)
    assert curious.policy.state_dict().keys() == plain.policy.state_dict().keys()
    again = learner(n_step=1, curiosity=10.0, seed=5)
    again.restore(curious.tensors(), curious.optimiser.steps)
    assert again.update(fixed_batch(), 0.5) == curious.update(fixed_batch(), 0.5)


def test_it_needs_single_transitions() -> None:
    with pytest.raises(ConfigError, match=r"agent\.curiosity: 1 is about single transitions"):
        D3qn(curiosity=1.0, n_step=3)
