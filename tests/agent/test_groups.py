"""The ring of valued groups, and the learner that learns from it."""

import dataclasses

import numpy as np
import pytest
import torch

from flipperctl.agent.losses import searched_values
from flipperctl.agent.replay import GroupBatch, GroupMemory
from flipperctl.api import StateGroups
from flipperctl.config import Teacher
from tests.agent.learners import ACTIONS, LAYOUT, fixed_batch, learner

STATES = 4
"""Number of states of a group [-]."""


def groups(*numbers: float) -> StateGroups:
    """Return groups whose observations and values are all equal to a number."""
    column = np.array(numbers, np.float32)[:, None, None]
    return StateGroups(
        observations=np.broadcast_to(column, (len(numbers), STATES, LAYOUT.size)).copy(),
        values=np.broadcast_to(10 * column, (len(numbers), STATES, ACTIONS)).copy(),
    )


def held(memory: GroupMemory) -> list[float]:
    """Return the numbers of the groups in the order of the ring."""
    arrays = memory.filled()
    assert np.array_equal(arrays["values"][:, 0, 0], 10 * arrays["observations"][:, 0, 0])
    return arrays["observations"][:, 0, 0].tolist()


def test_the_ring_forgets_the_oldest() -> None:
    memory = GroupMemory(3)
    assert (len(memory), memory.filled()) == (0, {})
    memory.add(groups(1.0, 2.0))
    assert held(memory) == [1.0, 2.0]
    memory.add(groups(3.0, 4.0))
    assert held(memory) == [4.0, 2.0, 3.0]
    assert (len(memory), memory.added) == (3, 4)
    memory.add(groups(5.0, 6.0, 7.0, 8.0, 9.0))  # more than fit
    assert sorted(held(memory)) == [7.0, 8.0, 9.0]


def test_samples_are_whole_groups_drawn_by_the_generator_handed_in() -> None:
    memory = GroupMemory(100)
    memory.add(groups(1.0, 2.0, 3.0))
    batch, again = (memory.sample(300, np.random.default_rng(0)) for _ in range(2))
    assert batch.observation.shape == (300, STATES, LAYOUT.size)
    assert batch.values.shape == (300, STATES, ACTIONS)
    assert torch.equal(batch.values, again.values)
    assert torch.equal(batch.values[:, 0, 0], 10 * batch.observation[:, 0, 0])
    # Each of the three 100 times, ± √(300 · 1/3 · 2/3) = 8
    counts = torch.bincount(batch.observation[:, 0, 0].long())[1:]
    assert counts.tolist() == pytest.approx([100] * 3, abs=33)


@pytest.mark.parametrize("numbers", [(), (1.0, 2.0), (1.0, 2.0, 3.0, 4.0)])
def test_a_restored_ring_continues_as_the_saved_one(numbers: tuple[float, ...]) -> None:
    saved, other = GroupMemory(3), GroupMemory(3)
    for number in numbers:
        saved.add(groups(number))
    other.restore({n: a.copy() for n, a in saved.filled().items()}, saved.added, LAYOUT.size)
    assert other.added == saved.added
    for memory in (saved, other):
        memory.add(groups(8.0))
    assert held(other) == held(saved)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"values": None}, r"there are \['observations'\]"),
        ({"added": 3}, "for 3 groups"),
        ({"added": 0}, "none were added"),
        ({"observations": np.zeros((2, STATES, LAYOUT.size + 1), np.float32)}, "shapes are"),
        ({"observations": np.zeros((2, STATES, LAYOUT.size))}, "shapes are"),  # float64
        ({"observations": np.zeros(2, np.float32)}, "shapes are"),
        ({"values": np.zeros((2, STATES + 1, ACTIONS), np.float32)}, "shapes are"),
        ({"values": np.full((2, STATES, ACTIONS), np.inf, np.float32)}, "not finite"),
        ({"extra": np.zeros(2, np.float32)}, "observations and values are allowed"),
    ],
)
def test_damaged_arrays_are_refused(change: dict[str, object], text: str) -> None:
    saved = GroupMemory(5)
    saved.add(groups(1.0, 2.0))
    given = {"added": 2, **saved.filled(), **change}
    added = given.pop("added")
    arrays = {name: array for name, array in given.items() if array is not None}
    with pytest.raises(ValueError, match=text):
        GroupMemory(5).restore(arrays, added, LAYOUT.size)


# The learner


def searched(**settings: float) -> Teacher:
    return Teacher(controller="value_iteration", loss="values", **settings)


def valued() -> GroupBatch:
    """Return groups of random observations, in each of which action 6 is best by 1."""
    generator = torch.Generator().manual_seed(1)
    observation = torch.randn(16, STATES, LAYOUT.size, generator=generator)
    values = 10 * observation[:, :, :1].repeat(1, 1, ACTIONS)
    values[:, :, 6] += 1.0
    return GroupBatch(observation, values)


def test_the_searched_values_are_weighted_scaled_and_added_to_the_temporal_difference() -> None:
    batch, groups = fixed_batch(), valued()
    plain = learner(reward_scale=0.2)
    with torch.no_grad():
        found = plain.online(groups.observation.flatten(0, 1)).unflatten(0, (16, STATES))
        loss = float(searched_values(found, 0.2 * groups.values, 5.0))
    td = plain.update(batch, 0.0)
    joined = learner(reward_scale=0.2, teacher=searched(td_weight=2.0, weight=4.0, weight_end=0.0))
    assert joined.update(batch, 0.25, [groups]) == pytest.approx(2 * td + 3 * loss)  # 4 · (1 - ¼)
    alone = learner(reward_scale=0.2, teacher=searched(td_weight=2.0))
    assert alone.update(batch, 0.25) == pytest.approx(2 * td)  # no groups yet


def test_each_step_of_an_update_has_groups_of_its_own() -> None:
    teacher, batch, groups = searched(), fixed_batch(16), valued()
    batch = dataclasses.replace(batch, discount=torch.zeros(16))
    other = dataclasses.replace(groups, values=-groups.values)
    together, alone = (learner(batch_size=8, teacher=teacher) for _ in range(2))
    last = together.update(batch, 0.0, [groups, other])
    for start, part in ((0, groups), (8, other)):
        found = alone.update(batch.rows(slice(start, start + 8)), 0.0, [part])
    assert last == found


def test_it_learns_which_action_is_best() -> None:
    agent, groups = learner(teacher=searched(), learning_rate=1e-3), valued()
    for _ in range(60):
        agent.update(fixed_batch(), 0.0, [groups])
    with torch.no_grad():
        found = agent.online(groups.observation.flatten(0, 1))
    assert (found.argmax(dim=1) == 6).float().mean() > 0.9
