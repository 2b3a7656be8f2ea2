"""``zimmermann`` and ``hfc``: what they learn and decide, in cases that were worked by hand."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from flipperctl_plugins.controllers.ground import Ground, ground
from flipperctl_plugins.controllers.hfc import NEXT, TEMPLATES, Hfc, labels, softmax_fit
from flipperctl_plugins.controllers.zimmermann import (
    CELLS,
    POSTURES,
    Visit,
    Zimmermann,
    cell,
    q_update,
    tried,
)
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, ObservationLayout, Outcome, Perception, RecordedEpisode, Robot

LAYOUT, ROBOT = ObservationLayout(), Robot()
X = (np.arange(15) - 7) * 0.15  # centres of the bins [m]


def perceive(
    heights: NDArray[np.floating] | float = 0.0,
    *,
    pitch: float = 0.0,
    front: float = 0.0,
    rear: float = 0.0,
    x: float | None = None,
) -> Perception:
    """Return a perception of the ground at each of ``X``, above that of a level robot [m].

    ``x``: odometry [m]; None: there is none.
    """
    seen = np.full(15, heights) - 0.1
    observation = np.concatenate([seen, seen, [front, rear, pitch]]).astype(np.float32)
    points, rng = np.column_stack([X, seen]), np.random.default_rng(0)
    return Perception(
        observation,
        points,
        pitch,
        front,
        rear,
        ROBOT,
        LAYOUT,
        rng,
        recent=(observation,),
        position=None if x is None else np.array([x, 0.0]),
    )


def turns(action: int) -> tuple[int, ...]:
    return tuple(ACTIONS[action])


def test_the_ground_is_that_below_the_flippers_and_the_rear_half() -> None:
    # Ahead lie the bins at 0.45 and 0.6 m (0.38 to 0.716 m), below the rear those at -0.3 to 0 m.
    p = perceive(np.select([X > 0.5, X > 0.4, X < -0.35, X < -0.2], [0.3, 0.1, 9.0, -0.2], 0.0))
    assert ground(p.observation, LAYOUT, ROBOT) == pytest.approx((0.1, 0.3, -0.2, 0.0), abs=1e-6)
    narrow = ObservationLayout(bins=3, highest=False)  # up to 0.225 m: the outermost ones count
    assert ground(np.float32([0, 0.1, 0.2, 0, 0, 0]), narrow, ROBOT) == pytest.approx(
        (0.3, 0.3, 0.1, 0.2), abs=1e-6
    )


def test_cells_differ_by_pitch_and_ground() -> None:
    level = Ground(0.0, 0.0, 0.0, 0.0)
    assert cell(level, 0.0) == 12
    assert cell(level, -0.3) == 0
    assert cell(level, 0.3) == 24
    assert cell(level._replace(highest=0.1), 0.0) == 16
    assert cell(level._replace(highest=0.3), 0.0) == 20
    assert cell(level._replace(lowest=-0.2), 0.0) == 14
    assert cell(level._replace(rear_lowest=-0.2), 0.0) == 13


def test_q_values_of_two_cells_follow_two_episodes() -> None:
    q, counts = np.zeros((2, 2)), np.zeros((2, 2))
    visits = [Visit(0, 0, 0), Visit(1, 1, 2)]  # two decisions in cell 0, then one in cell 1
    rewards = np.array([-1.0, -1.0, -4.0])
    q_update(q, counts, visits, rewards, discount=0.5, trace=0.5)
    # Cell 1: -4. Cell 0: -1 - 0.5, and after it the posture that was never tried, worth 0.
    assert q.tolist() == [[-1.5, 0.0], [0.0, -4.0]]
    q[1, 0] = -8.0
    q_update(q, counts, visits, rewards, discount=0.5, trace=0.5)
    # The posture is the best of cell 1 now: half its value -4, half its return -4, both 0.25 fold.
    assert q[1, 1] == -4.0
    assert q[0, 0] == pytest.approx(-1.5 + (-2.5 + 1.5) / 2**0.8)
    assert counts.tolist() == [[2, 0], [0, 2]]
    # What was never tried is no better than the worst that was.
    assert tried(np.array([[-1.0, 0.0, -3.0]]), np.array([[1, 0, 1]])).tolist() == [[-1, -3, -3]]


class Paid:
    """Episodes of one decision on level ground, whose reward is the front pair's target."""

    def __init__(self, count: int) -> None:
        self.left, self.rng = count, np.random.default_rng(0)

    def play(self, policy: Any) -> RecordedEpisode:
        self.left -= 1
        policy.reset(None)
        policy.act(perceive())
        front, _ = POSTURES[policy.visits[-1].posture]
        return recorded(np.zeros((2, 33)), reward=front)


def recorded(observations: NDArray[np.floating], reward: float = 0.0) -> RecordedEpisode:
    count = len(observations) - 1
    return RecordedEpisode(
        number=0,
        seed=0,
        terrain="",
        outcome=Outcome.REACHED,
        observations=observations.astype(np.float32),
        actions=np.zeros(count, np.int64),
        rewards=np.full(count, reward),
        labels=np.zeros((count, 9), np.float32),
    )


def test_zimmermann_takes_the_posture_that_pays() -> None:
    values = np.full((CELLS, 5), -1.0)
    values[12, 2] = 0.0  # L: 0.7 and 0 rad
    rule = Zimmermann(q=values.tolist())
    assert turns(rule.act(perceive())) == (1, 0)
    assert turns(rule.act(perceive(front=0.7, rear=0.3))) == (0, -1)
    assert turns(rule.act(perceive(pitch=0.3))) == (0, 0)  # equal: I
    paid: Any = Paid(200)
    learnt = Zimmermann().learn(paid)
    assert learnt.q[12] == pytest.approx([front for front, _ in POSTURES], abs=0.01)
    assert set(learnt.q[0]) == {0.0}  # never met


N, AF, US, AR, DF, DS, DR = range(7)


def test_states_follow_angles_and_pitch_along_permitted_transitions() -> None:
    def path(*angles: tuple[float, float, float]) -> list[int]:
        return labels(np.array(angles), np.array(TEMPLATES))

    up = (0.4, 0.0, 0.2), (-0.1, -0.1, 0.4), (-0.1, -0.6, 0.2), (0.0, 0.0, 0.0)
    assert path(*up) == [N, AF, US, AR, N]
    down = (-0.35, -0.7, -0.2), (0.0, 0.05, -0.4), (0.3, 0.4, -0.2), (0.0, 0.0, 0.0)
    assert path(*down) == [N, DF, DS, DR, N]
    # A rear that ascends must follow a front that does.
    assert path(*[(-0.1, -0.6, 0.2)] * 8) == [N, AF, *[AR] * 7]


def test_a_softmax_fits_shares() -> None:
    inputs = np.array([[1.0, 0, 0, 0, 0, 0]] * 4)
    (row,) = softmax_fit(inputs, np.array([1, 1, 0, 1]), 2)
    # 4 σ(w) - 3 + w = 0; without the prior ln 3 = 1.10
    assert row == pytest.approx([0.505, 0, 0, 0, 0, 0], abs=0.001)
    assert softmax_fit(np.empty((0,)), np.empty(0, np.int64), 3).tolist() == [[0.0] * 6] * 2


def test_escape_lifts_the_front_and_lowers_the_rear() -> None:
    rule = Hfc()
    assert rule.targets(AR, 0.5) == pytest.approx((-0.1 + 0.15, -0.6 - 0.25))
    assert rule.targets(AF, 0.5) == (0.4, 0.0)


def test_the_likeliest_state_acts_and_stagnation_comes_from_odometry() -> None:
    weights = np.zeros((12, 6))
    weights[0, 0] = math.log(3)  # neutral → ascending front; the features begin with 1
    weights[6, 0] = -5.0  # ascending rear → neutral
    machine: Any = Hfc(weights=weights.tolist()).build()
    machine.reset(None)
    assert turns(machine.act(perceive(x=0.0))) == (1, 0)  # ascending front: 0.4 rad
    assert machine.chances == pytest.approx([0.2, 0.6, 0, 0, 0.2, 0, 0])
    machine.act(perceive(x=0.0))
    # From ascending front and descending front, four states are equally likely each.
    assert machine.chances == pytest.approx([0.24, 0.27, 0.15, 0.15, 0.09, 0.05, 0.05])
    machine.chances = np.eye(7)[AR]
    # 0.06 m in 0.6 s at 0.2 m/s, s = 0.5: 0.05 and -0.85 rad
    held = perceive(x=0.06, front=0.05 - 0.14, rear=-0.85 + 0.12)
    assert turns(machine.act(held)) == (1, 0)
    machine.reset(None)
    assert machine.chances.tolist() == [1, 0, 0, 0, 0, 0, 0]
    machine.chances = np.eye(7)[AR]
    assert turns(machine.act(perceive(front=-0.1, rear=-0.6))) == (0, 0)  # no odometry: no escape


class Shown:
    """Demonstrations: the front pair is raised one decision after a wall of 0.3 m is seen."""

    layout, robot = LAYOUT, ROBOT

    def demonstrations(self) -> Iterator[RecordedEpisode]:
        for begin in (3, 5, 7):
            wall = perceive(np.where(X > 0.4, 0.3, 0.0)).observation
            seen = np.array([perceive().observation] * begin + [wall] * 3)
            seen[begin + 1 :, -3] = 0.4
            yield recorded(seen)


def test_hfc_learns_transitions_from_demonstrations() -> None:
    shown: Any = Shown()
    machine: Any = Hfc().learn(shown).build()
    machine.reset(None)
    assert turns(machine.act(perceive())) == (0, 0)
    assert turns(machine.act(perceive(np.where(X > 0.4, 0.3, 0.0)))) == (1, 0)
    assert sum(len(after) - 1 for after in NEXT) == 12
