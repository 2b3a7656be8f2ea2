"""The learner: it acts greedily, learns a fixed batch and repeats itself."""

import dataclasses

import numpy as np
import pytest
import torch

from flipperctl.agent.losses import searched_values, teacher_large_margin
from flipperctl.agent.replay import Batch, GroupBatch, Replay
from flipperctl.api import Network, Perception, RobotGeometry
from flipperctl.api.plugin import registered_names
from flipperctl.checkpoint import join
from flipperctl.config import Teacher, resolver
from flipperctl.core.risk import LAGS
from flipperctl.errors import NonFiniteError
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ
from flipperctl.policies.acting import ExploringPolicy
from tests.agent.learners import ACTIONS, LAYOUT, Ramp, fixed_batch, learner


def weights(agent: DoubleQ) -> dict[str, torch.Tensor]:
    return {name: p.detach().clone() for name, p in agent.online.named_parameters()}


def explored(agent: DoubleQ, epsilon: float, count: int) -> list[int]:
    """Return actions of the exploring policy, all for the same observation."""
    rng = np.random.default_rng(0)
    policy = ExploringPolicy(agent.online, 1, lambda: epsilon, rng, agent.noise_rng)
    return [action for action, _ in actions(policy, count)]


def actions(explorer: ExploringPolicy, count: int) -> list[tuple[int, bool]]:
    """Return actions for one observation, and whether each was random."""
    rng, zeros = np.random.default_rng(0), np.zeros(LAYOUT.size, np.float32)
    p = Perception(
        zeros, np.empty((0, 2)), 0.0, 0.0, 0.0, RobotGeometry(), LAYOUT, rng, recent=(zeros,)
    )
    return [(explorer.act(p), explorer.explored) for _ in range(count)]


def test_acts_greedily_without_epsilon_and_uniformly_with_all_of_it() -> None:
    agent = DoubleQ(Ramp(), LAYOUT, D3qn(), seed=0)
    assert set(explored(agent, 0.0, 20)) == {ACTIONS - 1}
    drawn = np.bincount(explored(agent, 1.0, 900))
    # Each of nine 100 times, ± √(900 · 1/9 · 8/9) = 9
    assert drawn.tolist() == pytest.approx([100] * 9, abs=36)


def test_random_actions_are_reported_and_a_share_of_the_episodes_has_some() -> None:
    agent, rng = DoubleQ(Ramp(), LAYOUT, D3qn(), seed=0), np.random.default_rng(0)
    taken = actions(ExploringPolicy(agent.online, 1, lambda: 0.5, rng, rng), 200)
    assert {random for _, random in taken} == {True, False}
    assert all(random for action, random in taken if action != ACTIONS - 1)
    explorer, exploring = ExploringPolicy(agent.online, 1, lambda: 0.8, rng, rng, 0.25), 0
    for _ in range(200):
        explorer.reset(None)  # type: ignore[arg-type]  # it needs no simulator
        random = [random for _, random in actions(explorer, 8)]
        assert not any(random) or sum(random) > 1  # at most one of 8: 8e-5 of them
        exploring += any(random)
    assert exploring == pytest.approx(50, abs=20)  # ± √(200 · 1/4 · 3/4) = 6


def test_the_loss_of_one_decision_by_hand() -> None:
    agent = DoubleQ(Ramp(), LAYOUT, D3qn(reward_scale=1.0), seed=0)
    rising = torch.arange(ACTIONS, dtype=torch.float32)
    for network, slopes in ((agent.online, rising), (agent.target, 10 - rising)):
        assert isinstance(network, torch.nn.Linear)
        network.bias.data.zero_()
        network.weight.data[:, 0] = slopes  # Q_a = slope_a · (first number of the observation)
    observation, next_observation = torch.zeros(1, LAYOUT.size), torch.zeros(1, LAYOUT.size)
    observation[0, 0], next_observation[0, 0] = 2.0, 0.5
    one, half = torch.tensor([1.0]), torch.tensor([0.5])
    one_hot = torch.nn.functional.one_hot(torch.tensor(0), LAYOUT.size).float()
    batch = Batch(observation, torch.tensor([2]), one, next_observation, half)
    # Q = 2 · 2 = 4; next, the online network prefers action 8, which the target network values
    # at (10 - 8) · 0.5 = 1; so the target is 1 + 0.5 · 1 = 1.5, and 2.5 off costs 2.5 - 0.5.
    assert agent.update(batch, 0.0) == pytest.approx(2.0)
    single = DoubleQ(Ramp(), LAYOUT, D3qn(reward_scale=1.0, double=False), seed=0)
    single.online.load_state_dict({"weight": torch.outer(rising, one_hot), "bias": 0 * rising})
    single.target.load_state_dict({"weight": torch.outer(10 - rising, one_hot), "bias": 0 * rising})
    # The target network alone prefers action 0 and values it at 10 · 0.5 = 5: 1 + 0.5 · 5 = 3.5.
    assert single.update(batch, 0.0) == pytest.approx(0.5 * 0.5**2)


@pytest.mark.parametrize("network", registered_names("network"))
def test_an_update_moves_every_parameter(network: str) -> None:
    agent = learner(network)
    before = weights(agent)
    agent.update(fixed_batch(frames=3 if network == "stacked" else 1), 0.0)
    still = [name for name, now in weights(agent).items() if torch.equal(now, before[name])]
    assert still == []


def test_equal_seeds_give_equal_weights_and_leave_torch_s_generator_alone() -> None:
    state = torch.random.get_rng_state()
    first, second, third = learner(seed=1), learner(seed=1), learner(seed=2)
    assert torch.equal(state, torch.random.get_rng_state())
    for agent in (first, second, third):
        for _ in range(3):
            agent.update(fixed_batch(), 0.5)
    same, other = weights(second), weights(third)
    assert all(torch.equal(w, same[name]) for name, w in weights(first).items())
    assert not all(torch.equal(w, other[name]) for name, w in weights(first).items())


def test_the_target_follows_at_its_rate() -> None:
    agent = learner(target_rate=0.25)
    before = weights(agent)
    agent.update(fixed_batch(), 0.0)
    now = weights(agent)
    for name, slow in agent.target.named_parameters():
        expected = 0.75 * before[name] + 0.25 * now[name]
        assert torch.allclose(slow, expected, atol=1e-7)
        assert not slow.requires_grad


def test_rewards_are_scaled_inside_the_learner() -> None:
    batch = fixed_batch()
    tenth = dataclasses.replace(batch, reward=batch.reward / 10)
    inside, outside = learner(reward_scale=0.1), learner(reward_scale=1.0)
    assert inside.update(batch, 0.0) == pytest.approx(outside.update(tenth, 0.0))


def test_the_learning_rate_falls_with_the_fraction_of_the_run() -> None:
    # Adam's first step moves every weight with a gradient by the rate.
    for fraction, rate in [(0.0, 1e-3), (0.5, 6e-4), (1.0, 2e-4)]:
        agent = learner(learning_rate=1e-3, learning_rate_end=2e-4)
        before = weights(agent)
        agent.update(fixed_batch(), fraction)
        moved = max(float((w - before[n]).abs().max()) for n, w in weights(agent).items())
        assert moved == pytest.approx(rate, rel=1e-3)


def test_updates_together_equal_single_ones_where_no_target_depends_on_the_network() -> None:
    together, alone = (learner(batch_size=8, teacher=searched()) for _ in range(2))
    batch, groups = dataclasses.replace(fixed_batch(16), discount=torch.zeros(16)), valued()
    other = dataclasses.replace(groups, values=-groups.values)
    together.update(batch, 0.0, [groups, other])
    for start, part in ((0, groups), (8, other)):
        alone.update(batch.rows(slice(start, start + 8)), 0.0, [part])
    theirs = weights(alone)
    assert all(torch.equal(w, theirs[name]) for name, w in weights(together).items())
    assert together.optimiser.steps == alone.optimiser.steps == 2


def stored(batch: Batch, *, prioritised: bool = True, **columns: int) -> Replay:
    """Return a replay with the transitions of a batch."""
    size = len(batch.action)
    replay = Replay(size, LAYOUT.size, 1, 0.5, prioritised=prioritised, **columns)
    for name, tensor in batch._tensors().items():
        replay.arrays[name][:] = tensor.numpy()
    replay.added = size
    if prioritised:
        replay.set_priorities(np.arange(size), np.ones(size, np.float32))
    return replay


@pytest.mark.parametrize("network", ["mlp", "quantile"])
def test_errors_of_an_update_are_the_next_priorities(network: str) -> None:
    batch = dataclasses.replace(fixed_batch(64), discount=torch.zeros(64))
    agent = learner(network, priority=1.0, priority_floor=0.5, reward_scale=1.0, updates_together=1)
    with torch.no_grad():  # of the mean, where there are quantiles
        values = agent.online(batch.observation)[torch.arange(64), batch.action]
    replay = stored(batch)
    agent.update_from(replay, np.random.default_rng(0), 0.0)
    # One step of 128 equally probable transitions takes two from each 64th: all of them
    expected = (values - batch.reward).abs().numpy() + 0.5
    assert replay.arrays["priority"] == pytest.approx(expected, rel=1e-5)
    assert replay.largest == replay.arrays["priority"].max()


def test_transitions_with_large_errors_are_learnt_more_often() -> None:
    surprising = torch.arange(64) % 8 == 0
    rewards = torch.where(surprising, 20.0, 0.0)  # the network's own values are near 0
    replay = stored(dataclasses.replace(fixed_batch(), discount=torch.zeros(64), reward=rewards))
    agent = learner("mlp", priority=0.6, reward_scale=1.0)
    agent.update_from(replay, np.random.default_rng(0), 0.0)
    drawn, batch = replay.sample_by_priority(640, 1, np.random.default_rng(0), 0.5)
    # 20^0.6 = 6 for the errors that are large; the others are about 0.5 in size.
    assert np.isin(drawn, np.flatnonzero(surprising)).mean() > 0.5  # 1/8 of them if all were alike
    assert batch.weight is not None
    assert batch.weight[batch.reward > 0].max() < batch.weight[batch.reward == 0].min()


def test_the_risk_learns_from_transitions_that_nothing_chose() -> None:
    def risk(rewards: float) -> dict[str, torch.Tensor]:
        agent = learner("mlp", priority=0.6, batch_size=16, risk=True)
        marks = {"failing": torch.arange(64) % 2.0, "resembles": torch.zeros(64, len(LAGS))}
        batch = dataclasses.replace(fixed_batch(64), **marks)
        batch = dataclasses.replace(batch, reward=batch.reward * rewards)
        replay = stored(batch, risk_horizon=5, newest=LAYOUT.size)
        rng = np.random.default_rng(0)
        for _ in range(3):
            agent.update_from(replay, rng, 0.0)
        assert agent.risk is not None
        return agent.risk.network.state_dict()

    one, other = risk(1.0), risk(100.0)  # whose updates prefer others
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_a_label_raises_the_teachers_action_beside_the_temporal_difference() -> None:
    agent = learner("quantile", teacher=Teacher(controller="okada"))
    labels = torch.zeros(64, ACTIONS)
    labels[:, 6] = 1.0
    batch = dataclasses.replace(fixed_batch(), label=labels)
    first = agent.update(batch, 0.0)
    for _ in range(60):
        last = agent.update(batch, 0.0)
    assert last < first / 2
    with torch.no_grad():
        assert (agent.online(batch.observation).argmax(dim=1) == 6).float().mean() > 0.9


def test_the_margin_is_weighted_and_added_to_the_temporal_difference() -> None:
    labels = torch.zeros(64, ACTIONS)
    labels[:, 6] = 1.0
    batch = dataclasses.replace(fixed_batch(), label=labels)
    plain = learner()
    with torch.no_grad():
        margin = float(teacher_large_margin(plain.online(batch.observation), labels, 0.5))
    td = plain.update(batch, 0.0)
    kinds = {"controller": "okada", "loss": "margin", "margin": 0.5, "td_weight": 2.0}
    joined = learner(teacher=Teacher(**kinds, weight=4.0, weight_end=0.0))
    assert joined.update(batch, 0.25) == pytest.approx(2 * td + 3 * margin)  # 4 · (1 - 0.25)


def test_a_loss_that_is_not_finite_is_an_error() -> None:
    batch = fixed_batch()
    batch.reward[3] = torch.inf
    with pytest.raises(NonFiniteError, match="loss is inf"):
        learner().update(batch, 0.0)


def test_noise_explores_without_epsilon_and_is_off_in_a_validation() -> None:
    agent = learner("noisy")
    assert len(set(explored(agent, 0.0, 50))) > 1
    row = torch.zeros(1, LAYOUT.size)
    policy = agent.policy.eval()
    first = policy(row)
    explored(agent, 0.0, 1)
    assert torch.equal(policy(row), first)
    policy.train()
    assert not torch.equal(policy(row), first)


def test_each_update_draws_new_noise_from_the_learner_s_seed() -> None:
    agents = [learner("noisy", seed=4) for _ in range(2)]
    losses = [[agent.update(fixed_batch(), 0.0) for _ in range(2)] for agent in agents]
    assert losses[0] == losses[1]
    agents[0].noise_rng.random()
    assert agents[0].update(fixed_batch(), 0.0) != agents[1].update(fixed_batch(), 0.0)


# Searched values


def searched(**settings: float) -> Teacher:
    return Teacher(controller="value_iteration", loss="values", **settings)


def valued() -> GroupBatch:
    """Return groups of random observations, in each of which action 6 is best by 1."""
    generator = torch.Generator().manual_seed(1)
    observation = torch.randn(16, 4, LAYOUT.size, generator=generator)
    values = 10 * observation[:, :, :1].repeat(1, 1, ACTIONS)
    values[:, :, 6] += 1.0
    return GroupBatch(observation, values)


def test_the_searched_values_are_weighted_scaled_and_added_to_the_temporal_difference() -> None:
    batch, groups = fixed_batch(), valued()
    plain = learner(reward_scale=0.2)
    with torch.no_grad():
        found = plain.online(groups.observation.flatten(0, 1)).unflatten(0, (16, 4))
        loss = float(searched_values(found, 0.2 * groups.values, 5.0))
    td = plain.update(batch, 0.0)
    joined = learner(reward_scale=0.2, teacher=searched(td_weight=2.0, weight=4.0, weight_end=0.0))
    assert joined.update(batch, 0.25, [groups]) == pytest.approx(2 * td + 3 * loss)  # 4 · (1 - ¼)
    alone = learner(reward_scale=0.2, teacher=searched(td_weight=2.0))
    assert alone.update(batch, 0.25) == pytest.approx(2 * td)  # no groups yet


# The privileged baseline: it takes from the values what only the simulation can tell.

UNSEEN = 2.0
"""Size of what moves all values of a state alike and is not in its observation."""


def privileged_agent(network: str = "mlp", privileged: int = 1) -> DoubleQ:
    small = {"name": "mlp", "hidden": [32]} if network == "mlp" else network
    built = resolver.create("network", small, "network")
    assert isinstance(built, Network)
    return DoubleQ(built, LAYOUT, D3qn(reward_scale=1.0), seed=0, privileged=privileged)


def unseen_batch(size: int = 256) -> Batch:
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


def differences(learner: DoubleQ) -> torch.Tensor:
    """Return the values of the acting network minus that of action 0, (9,)."""
    with torch.no_grad():
        values = learner.online(torch.zeros(1, LAYOUT.size))[0]
    return values - values[0]


def test_small_differences_are_learnt_beneath_a_large_unseen_change() -> None:
    true = 0.1 * torch.arange(ACTIONS)
    errors, made = {}, unseen_batch()
    for privileged in (0, 1):
        learner = privileged_agent(privileged=privileged)
        for step in range(200):
            learner.update(made, step / 200)
        errors[privileged] = float((differences(learner) - true).abs().max())
    assert errors[1] < 0.1 < errors[0], errors


def test_the_next_state_s_baseline_is_discounted_into_the_target() -> None:
    learner = privileged_agent()
    assert learner.baselines is not None
    target = learner.baselines.target.layers[-1]
    assert isinstance(target, torch.nn.Linear)
    target.weight.data.zero_()
    target.bias.data.fill_(3.0)
    made = dataclasses.replace(unseen_batch(2), discount=torch.tensor([0.5, 0.0]))
    targets = torch.tensor([1.0, 1.0])
    assert learner.baselines.with_next(targets, made).tolist() == pytest.approx([2.5, 1.0])
    quantiles = learner.baselines.with_next(torch.ones(2, 4), made)
    assert quantiles.tolist() == [[2.5] * 4, [1.0] * 4]


def test_an_update_moves_the_baseline_its_target_follows_and_the_policy_has_neither() -> None:
    made = privileged_agent("quantile")
    before = {name: tensor.clone() for name, tensor in join(made.tensors()).items()}
    made.update(unseen_batch(), 0.0)
    moved = {
        name for name, now in join(made.tensors()).items() if not torch.equal(now, before[name])
    }
    assert moved >= {name for name in before if name.startswith("baselines.")} != set()
    plain = privileged_agent("quantile", privileged=0)
    assert made.policy.state_dict().keys() == plain.policy.state_dict().keys()
