"""The exploring policy: how long random actions last, and how many there are."""

from itertools import groupby

import numpy as np
import pytest

from flipperctl.agent.d3qn import D3qn
from flipperctl.api import Perception, RobotGeometry
from flipperctl.config import Agent
from flipperctl.policies.exploring import ExploringPolicy, start_probability
from tests.agent.learners import ACTIONS, LAYOUT, Ramp

ZEROS = np.zeros(LAYOUT.size, np.float32)
GREEDY = ACTIONS - 1


def policy(epsilon: float, persistence: float, share: float = 1.0) -> ExploringPolicy:
    agent = D3qn(Ramp(), LAYOUT, ACTIONS, Agent(), seed=0)
    rng = np.random.default_rng(0)
    return ExploringPolicy(agent.online, 1, lambda: epsilon, rng, rng, persistence, share)


def actions(explorer: ExploringPolicy, count: int) -> list[tuple[int, bool]]:
    """Return actions for one observation, and whether each was random."""
    rng = np.random.default_rng(0)
    p = Perception(
        ZEROS, np.empty((0, 2)), 0.0, 0.0, 0.0, RobotGeometry(), LAYOUT, rng, recent=(ZEROS,)
    )
    return [(explorer.act(p), explorer.explored) for _ in range(count)]


def test_the_fraction_of_random_actions_is_epsilon_however_long_they_last() -> None:
    # Of greedy runs that end with probability p at each decision there are (1 - p) / p decisions
    # for each random action of 4: 4 p / (4 p + 1 - p) = 1/4 for p = 1/13.
    assert start_probability(0.25, 4.0) == pytest.approx(1 / 13)
    assert start_probability(0.05, 1.0) == 0.05
    assert start_probability(1.0, 4.0) == 1.0
    taken = actions(policy(0.25, 4.0), 6000)
    assert np.mean([random for _, random in taken]) == pytest.approx(0.25, abs=0.04)


def test_a_random_action_is_repeated() -> None:
    runs = [
        (a, len(list(run))) for a, run in groupby(a for a, _ in actions(policy(0.2, 5.0), 4000))
    ]
    lengths = [length for action, length in runs if action != GREEDY]
    assert np.mean(lengths) == pytest.approx(5, abs=0.7)  # ± 5 / √140
    assert max(lengths) > 10


def test_single_random_actions_are_reported_and_greedy_ones_are_not() -> None:
    taken = actions(policy(0.5, 1.0), 200)
    assert {random for _, random in taken} == {True, False}
    assert all(random for action, random in taken if action != GREEDY)


def test_a_random_action_ends_with_its_episode() -> None:
    explorer = policy(1.0, 50.0)
    (first, _), *_ = actions(explorer, 1)
    begun = set()
    for _ in range(20):
        explorer.reset(None)  # type: ignore[arg-type]  # it needs no simulator
        begun.add(actions(explorer, 1)[0][0])
    assert len(begun | {first}) > 4


def test_a_share_of_the_episodes_has_random_actions_and_the_others_have_none() -> None:
    explorer, exploring = policy(0.8, 1.0, share=0.25), 0
    for _ in range(200):
        explorer.reset(None)  # type: ignore[arg-type]  # it needs no simulator
        random = [random for _, random in actions(explorer, 8)]
        assert not any(random) or sum(random) > 1  # 8 of 8 or 7 of 8 greedy: in 8e-5 of them
        exploring += any(random)
    assert exploring == pytest.approx(50, abs=20)  # ± √(200 · 1/4 · 3/4) = 6
