"""The exploring policy: which actions and which episodes are random."""

import numpy as np
import pytest

from flipperctl.agent.d3qn import D3qn
from flipperctl.api import Perception, RobotGeometry
from flipperctl.config import Agent
from flipperctl.policies.exploring import ExploringPolicy
from tests.agent.learners import ACTIONS, LAYOUT, Ramp

ZEROS = np.zeros(LAYOUT.size, np.float32)
GREEDY = ACTIONS - 1


def policy(epsilon: float, share: float = 1.0) -> ExploringPolicy:
    agent = D3qn(Ramp(), LAYOUT, ACTIONS, Agent(), seed=0)
    rng = np.random.default_rng(0)
    return ExploringPolicy(agent.online, 1, lambda: epsilon, rng, rng, share)


def actions(explorer: ExploringPolicy, count: int) -> list[tuple[int, bool]]:
    """Return actions for one observation, and whether each was random."""
    rng = np.random.default_rng(0)
    p = Perception(
        ZEROS, np.empty((0, 2)), 0.0, 0.0, 0.0, RobotGeometry(), LAYOUT, rng, recent=(ZEROS,)
    )
    return [(explorer.act(p), explorer.explored) for _ in range(count)]


def test_single_random_actions_are_reported_and_greedy_ones_are_not() -> None:
    taken = actions(policy(0.5), 200)
    assert {random for _, random in taken} == {True, False}
    assert all(random for action, random in taken if action != GREEDY)


def test_a_share_of_the_episodes_has_random_actions_and_the_others_have_none() -> None:
    explorer, exploring = policy(0.8, share=0.25), 0
    for _ in range(200):
        explorer.reset(None)  # type: ignore[arg-type]  # it needs no simulator
        random = [random for _, random in actions(explorer, 8)]
        assert not any(random) or sum(random) > 1  # at most one of 8: 8e-5 of them
        exploring += any(random)
    assert exploring == pytest.approx(50, abs=20)  # ± √(200 · 1/4 · 3/4) = 6
