"""The policy gradient: advantages by hand, and what its updates do to a policy."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl.agent.losses import clipped_gain, divergence
from flipperctl.agent.replay import Batch, Replay
from flipperctl.api import Network
from flipperctl.config import resolver
from flipperctl.errors import NonFiniteError
from flipperctl.learners import PolicyGradient
from flipperctl.learners.clipped import ClippedGradient, advantages, limited

from .learners import ACTIONS, LAYOUT

TEMPERATURE = 0.5


def learner(**settings: Any) -> ClippedGradient:
    built = resolver.create("network", {"name": "mlp", "hidden": [32]}, "network")
    assert isinstance(built, Network)
    shared = {"temperature": TEMPERATURE, "decisions": 64, "warm_up": 0}
    agent = PolicyGradient(**{"batch_size": 64, "reward_scale": 1.0, **shared, **settings})
    return ClippedGradient(built, LAYOUT, agent, seed=0, privileged=2)


def probabilities(agent: ClippedGradient, observation: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return torch.softmax(agent.online.eval()(observation) / TEMPERATURE, dim=1)


def round_of(agent: ClippedGradient, rng: np.random.Generator, best: int = 3) -> Batch:
    """Decisions that the policy drew itself; action ``best`` pays 1, all others nothing."""
    observation = torch.from_numpy(rng.normal(0, 0.3, (256, LAYOUT.size)).astype(np.float32))
    label = probabilities(agent, observation)
    action = torch.from_numpy(np.array([rng.choice(ACTIONS, p=p / p.sum()) for p in label.numpy()]))
    return Batch(
        observation=observation,
        action=action,
        reward=(action == best).float(),
        next_observation=observation,
        discount=torch.zeros(256),
        label=label,
        privileged=torch.zeros(256, 2),
        next_privileged=torch.zeros(256, 2),
    )


def trained(rounds: int, **settings: Any) -> tuple[ClippedGradient, list[float]]:
    agent, rng = learner(**settings), np.random.default_rng(1)
    found = []
    for _ in range(rounds):
        batch = round_of(agent, rng)
        found.append(float(probabilities(agent, batch.observation)[:, 3].mean()))
        agent.update(batch, 0.0, rng)
    return agent, found


def test_advantages_sum_later_differences_up_to_the_end_of_the_episode() -> None:
    differences = np.array([1, 2, 3, 10], np.float32)
    discounts = np.array([0.9, 0.9, 0.0, 0.0], np.float32)
    expected = [1 + 0.45 * (2 + 0.45 * 3), 2 + 0.45 * 3, 3, 10]
    assert advantages(differences, discounts, 0.5) == pytest.approx(np.array(expected))


def test_values_learn_the_return_and_a_copy_goes_on_with_the_counts() -> None:
    agent = learner()
    batch = replace(round_of(agent, np.random.default_rng(0)), reward=torch.arange(256.0))
    _, goal = agent._advantages(batch)
    torch.testing.assert_close(goal, batch.reward)  # each decision ends its episode
    _, half = learner(reward_scale=0.5)._advantages(batch)
    torch.testing.assert_close(half, 0.5 * batch.reward)
    later = replace(batch, discount=torch.full((256,), 0.9))
    after = agent.values(batch.next_observation, torch.zeros(256, 2)).detach()[-1]
    _, goal = agent._advantages(later)  # 0.9 of the value that follows, where it goes on
    assert float(goal[-1]) == pytest.approx(255 + 0.9 * float(after))
    copy = learner()
    agent.update(batch, 0.0, np.random.default_rng(0))
    copy.restore(agent.tensors(), 0)
    copy.restore_counters(agent.counters())
    assert copy.rounds == 1
    assert copy.optimiser.steps == agent.optimiser.steps
    assert copy._value_optimiser.steps == agent._value_optimiser.steps


def test_limited_advantages_let_rare_failures_outweigh_the_rest_no_longer() -> None:
    usual = torch.linspace(-1, 1, 990)
    found = torch.cat([usual, torch.full((10,), -50.0)])
    weight = {}
    for clip in (None, 1.0):
        scaled = limited(found, clip)
        assert float(scaled.mean()) == pytest.approx(0.0, abs=1e-5)
        assert float(scaled.std(unbiased=False)) == pytest.approx(1.0, abs=1e-4)
        assert torch.equal(scaled[:990].argsort(), usual.argsort())  # the order remains
        weight[clip] = float(scaled[990:].square().mean() / scaled[:990].square().mean())
    assert weight[1.0] < weight[None] / 20


def test_the_gain_is_the_advantage_times_the_ratio_up_to_the_clip() -> None:
    before = torch.tensor([[0.5, 0.5]]).expand(3, 2)
    now = torch.tensor([[0.8, 0.2], [0.2, 0.8], [0.55, 0.45]]).log()
    action, advantage = torch.tensor([0, 0, 0]), torch.tensor([2.0, -1.0, 1.0])
    found = clipped_gain(now, action, before, advantage, 0.2)
    # 1.6 is clipped to 1.2; a lower ratio of a bad action gains nothing beyond 0.8; 1.1 is within
    assert float(found) == pytest.approx((1.2 * 2 - 0.8 + 1.1) / 3)


def test_the_divergence_is_that_of_kullback_and_leibler() -> None:
    p, q = torch.tensor([[0.5, 0.5, 0.0]]), torch.tensor([[0.25, 0.5, 0.25]])
    assert float(divergence(p, q.log())) == pytest.approx(0.5 * math.log(2))
    assert float(divergence(q, q.log())) == pytest.approx(0.0, abs=1e-7)


def test_what_pays_becomes_probable() -> None:
    _, found = trained(15, learning_rate=0.006, divergence=0.1)
    assert found[0] < 0.2
    assert found[-1] > 0.8


def test_the_temperature_falls_linearly_or_stays() -> None:
    falling = PolicyGradient(temperature=0.05, temperature_end=0.01)
    assert [falling.temperature_at(f) for f in (0, 0.5, 1)] == pytest.approx([0.05, 0.03, 0.01])
    assert PolicyGradient(temperature=0.2).temperature_at(0.9) == 0.2


def test_an_anchor_keeps_the_policy_near_its_start() -> None:
    settings = {"divergence": 0.1, "anchor": 10.0}
    _, found = trained(15, learning_rate=0.006, **settings)
    assert found[-1] < found[0] + 0.1


def test_the_policy_stops_at_its_divergence_while_the_values_go_on() -> None:
    agent, rng = learner(learning_rate=0.01, divergence=1e-6), None
    rng = np.random.default_rng(0)
    agent.update(round_of(agent, rng), 0.0, rng)
    assert agent.optimiser.steps == 2  # the second one finds that the first went too far
    assert agent._value_optimiser.steps == 3 * 4


def test_in_its_first_rounds_only_the_values_learn() -> None:
    agent, rng = learner(warm_up=1), np.random.default_rng(0)
    before = {name: tensor.clone() for name, tensor in agent.online.state_dict().items()}
    agent.update(round_of(agent, rng), 0.0, rng)
    assert agent._value_optimiser.steps == 8 * 4
    after = agent.online.state_dict()
    assert all(torch.equal(after[name], tensor) for name, tensor in before.items())
    agent.update(round_of(agent, rng), 0.0, rng)
    assert any(not torch.equal(agent.online.state_dict()[n], t) for n, t in before.items())


def test_values_that_are_not_finite_are_refused() -> None:
    agent, rng = learner(), np.random.default_rng(0)
    batch = round_of(agent, rng)
    with pytest.raises(NonFiniteError, match="the loss of the values is"):
        agent.update(replace(batch, reward=batch.reward * math.inf), 0.0, rng)


def test_the_newest_transitions_come_in_their_order_across_the_end_of_the_ring() -> None:
    replay, one = Replay(8, 1, 1, 0.9, labels=2), np.ones(1, np.float32)
    for number in range(11):
        label = np.array([1, 0], np.float32)
        over = number % 4 == 3
        replay.add(one, number % 9, float(number), one, over=over, bootstrap=False, label=label)
    assert replay.newest(5).reward.tolist() == [6, 7, 8, 9, 10]
    assert replay.newest(100).reward.tolist() == [3, 4, 5, 6, 7, 8, 9, 10]
    kept = Replay(4, 1, 1, 0.9)
    for number in range(7):
        kept.add(one, 0, float(number), one, over=True, bootstrap=False)
        if number == 0:
            kept.keep()  # the others share the remaining 3 rows
    assert kept.newest(100).reward.tolist() == [4, 5, 6]


@pytest.mark.parametrize(
    ("given", "budget", "size"),
    [(None, 30_000, 2048), (None, 400_000, 10_000), (None, 2_000_000, 24_576), (64, 400_000, 64)],
)
def test_a_round_is_a_fortieth_of_the_budget(given: int | None, budget: int, size: int) -> None:
    settings = PolicyGradient(decisions=given, replay_size=60_000)
    assert settings.round_size(budget) == size
    assert PolicyGradient(replay_size=1000).round_size(budget) == 500
