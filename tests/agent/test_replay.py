"""The n-step replay against sums worked by hand, and the ring of valued groups."""

import numpy as np
import pytest
import torch

from flipperctl.agent.replay import GroupMemory, Replay
from flipperctl.api import StateGroups
from tests.agent.learners import ACTIONS, LAYOUT


def observation(number: float) -> np.ndarray:
    return np.full(2, number, np.float32)


def feed(
    replay: Replay, rewards: list[float], *, over: bool = True, bootstrap: bool = False
) -> None:
    """Add an episode whose decision i leads from observation i to i + 1 by action i."""
    for i, reward in enumerate(rewards):
        last = over and i == len(rewards) - 1
        replay.add(
            observation(i), i, reward, observation(i + 1), over=last, bootstrap=bootstrap and last
        )


def rows(replay: Replay) -> list[tuple[float, int, float, float, float]]:
    """Return (observation, action, reward, next observation, discount) of each transition."""
    a = replay.arrays
    columns = (
        a["observation"][:, 0],
        a["action"],
        a["reward"],
        a["next_observation"][:, 0],
        a["discount"],
    )
    return [tuple(row) for row in np.column_stack(columns)[: len(replay)].tolist()]


def test_transitions_are_drawn_in_proportion_to_their_priorities() -> None:
    replay = Replay(4, size=2, n_step=1, gamma=0.5, prioritised=True)
    feed(replay, [0.0, 1.0, 2.0])
    replay.set_priorities(np.arange(3), np.array([1.0, 0.0, 3.0], np.float32))
    rows, batch = replay.sample_by_priority(80, 2, np.random.default_rng(0), 0.5)
    # Of each step's 40 strata a quarter lies in the first row, none in the second.
    for step in (slice(0, 40), slice(40, 80)):
        assert np.bincount(rows[step], minlength=3).tolist() == [10, 0, 30]
    assert batch.reward.tolist() == rows.tolist()
    # Weights (N p)^-1/2 for p = 1/4 and 3/4, divided by their mean
    low, high = (3 / 4) ** -0.5, (9 / 4) ** -0.5
    mean = (10 * low + 30 * high) / 40
    assert batch.weight is not None
    expected = np.where(rows == 0, low, high) / mean
    assert batch.weight.numpy() == pytest.approx(expected, rel=1e-5)


def test_new_transitions_have_the_largest_priority_in_a_restored_replay_too() -> None:
    replay = Replay(3, size=2, n_step=1, gamma=0.5, prioritised=True)
    feed(replay, [0.0, 1.0, 2.0])
    assert replay.arrays["priority"].tolist() == [1.0, 1.0, 1.0]
    replay.set_priorities(np.array([0, 1]), np.array([4.0, 2.0], np.float32))
    feed(replay, [3.0])  # in place of the largest
    other = Replay(3, size=2, n_step=1, gamma=0.5, prioritised=True)
    other.restore(replay.filled(), replay.added)
    for each in (replay, other):
        feed(each, [4.0])
        assert each.arrays["priority"].tolist() == [4.0, 4.0, 1.0]


def test_a_running_episode_can_be_taken_back() -> None:
    replay = Replay(10, size=2, n_step=1, gamma=0.5)
    feed(replay, [1.0, 2.0])
    before = rows(replay)
    feed(replay, [3.0, 4.0, 5.0], over=False)
    replay.take_back()
    assert rows(replay) == before
    replay.take_back()  # no episode is running
    assert rows(replay) == before
    feed(replay, [6.0])
    assert rows(replay) == [*before, (0, 0, 6.0, 1, 0.0)]


def test_n_steps_are_summed_and_the_rest_is_flushed_at_the_end() -> None:
    replay = Replay(10, size=2, n_step=3, gamma=0.5)
    feed(replay, [1.0, 2.0, 4.0, 8.0])
    assert rows(replay) == [
        (0, 0, 3.0, 3, 0.125),  # 1 + 2/2 + 4/4, and γ³
        (1, 1, 6.0, 4, 0.0),  # 2 + 4/2 + 8/4; the episode ended
        (2, 2, 8.0, 4, 0.0),  # 4 + 8/2
        (3, 3, 8.0, 4, 0.0),
    ]


def test_a_sum_ends_before_the_next_random_action() -> None:
    replay = Replay(10, size=2, n_step=3, gamma=0.5, cut_at_random=True)
    for i, explored in enumerate([True, False, True, False]):
        replay.add(
            *(observation(i), i, float(2**i), observation(i + 1)),
            over=i == 3,
            bootstrap=False,
            explored=explored,
        )
    assert rows(replay) == [
        (0, 0, 2.0, 2, 0.25),  # 1 + 2/2; its own action may be random, that of observation 2 not
        (1, 1, 2.0, 2, 0.5),
        (2, 2, 8.0, 4, 0.0),  # 4 + 8/2; the episode ended
        (3, 3, 8.0, 4, 0.0),
    ]


def test_the_target_bootstraps_after_an_end_that_is_bootstrapped() -> None:
    replay = Replay(10, size=2, n_step=3, gamma=0.5)
    feed(replay, [1.0, 2.0], bootstrap=True)  # shorter than n
    assert rows(replay) == [
        (0, 0, 2.0, 2, 0.25),  # 1 + 2/2, two decisions later: γ²
        (1, 1, 2.0, 2, 0.5),
    ]


def test_a_decision_waits_until_its_n_th_reward_is_known() -> None:
    replay = Replay(10, size=2, n_step=3, gamma=0.5)
    feed(replay, [1.0, 2.0], over=False)
    assert len(replay) == 0
    with pytest.raises(RuntimeError, match="between episodes"):
        replay.filled()


def test_the_ring_forgets_the_oldest() -> None:
    replay = Replay(3, size=2, n_step=1, gamma=0.5)
    feed(replay, [0.0, 1.0, 2.0, 3.0, 4.0])
    assert len(replay) == 3
    assert replay.added == 5
    assert [row[2] for row in rows(replay)] == [3.0, 4.0, 2.0]  # 3 took the place of 0, 4 of 1


def test_samples_are_drawn_from_what_is_filled_by_the_generator_handed_in() -> None:
    replay = Replay(100, size=2, n_step=1, gamma=0.5)
    feed(replay, [1.0, 2.0, 3.0])
    batch = replay.sample(300, np.random.default_rng(0))
    again = replay.sample(300, np.random.default_rng(0))
    # Each of the three 100 times, ± √(300 · 1/3 · 2/3) = 8
    assert batch.reward.unique().tolist() == [1.0, 2.0, 3.0]
    assert batch.action.bincount().tolist() == pytest.approx([100, 100, 100], abs=33)
    assert batch.observation.shape == batch.next_observation.shape == (300, 2)
    assert (batch.action.float() + 1 == batch.reward).all()  # the columns belong together
    assert (batch.action == again.action).all()


def test_a_restored_ring_continues_as_the_saved_one() -> None:
    saved = Replay(4, size=2, n_step=2, gamma=0.5)
    feed(saved, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    other = Replay(4, size=2, n_step=2, gamma=0.5)
    feed(other, [7.0], over=False)  # its pending decision is discarded
    other.restore({name: array.copy() for name, array in saved.filled().items()}, saved.added)
    assert rows(other) == rows(saved)
    for replay in (saved, other):
        feed(replay, [10.0, 20.0])
    assert rows(other) == rows(saved)
    assert [row[2] for row in rows(saved)] == [6.5, 5.0, 20.0, 20.0]  # 4 + 5/2, 5; 10 + 20/2, 20


def test_a_label_belongs_to_the_first_decision_of_its_transition() -> None:
    replay = Replay(10, size=2, n_step=2, gamma=0.5, labels=3)
    here = np.zeros(2, np.float32)
    for step, label in enumerate(([1, 0, 0], None, [0, 0.5, 0.5])):
        row = None if label is None else np.array(label, np.float32)
        over = step == 2
        replay.add(here, step, 0.0, here, over=over, bootstrap=False, label=row)
    assert replay.filled()["label"].tolist() == [[1, 0, 0], [0, 0, 0], [0, 0.5, 0.5]]
    batch = replay.sample(8, np.random.default_rng(0))
    assert batch.label is not None
    expected = replay.arrays["label"][batch.action.numpy()]
    assert (batch.label.numpy() == expected).all()
    assert "label" not in Replay(10, size=2, n_step=1, gamma=0.5).arrays


def test_kept_transitions_are_never_overwritten() -> None:
    replay = Replay(5, size=2, n_step=1, gamma=0.5)
    feed(replay, [1.0, 2.0])
    replay.keep()
    feed(replay, [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0])  # 0 to 6, three at a time
    assert [row[2] for row in rows(replay)] == [1.0, 2.0, 70.0, 50.0, 60.0]
    other = Replay(5, size=2, n_step=1, gamma=0.5)
    other.restore(replay.filled(), replay.added, replay.kept)
    feed(other, [80.0])
    assert [row[2] for row in rows(other)] == [1.0, 2.0, 70.0, 80.0, 60.0]


def test_kept_transitions_must_leave_room() -> None:
    replay = Replay(2, size=2, n_step=1, gamma=0.5)
    feed(replay, [1.0, 2.0])
    with pytest.raises(RuntimeError, match="2 kept transitions fill the replay"):
        replay.keep()


# Groups of valued states

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


def test_the_ring_of_groups_forgets_the_oldest() -> None:
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
def test_a_restored_ring_of_groups_continues_as_the_saved_one(numbers: tuple[float, ...]) -> None:
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
        ({"observations": np.zeros((2, STATES, LAYOUT.size + 1), np.float32)}, "shapes are"),
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
