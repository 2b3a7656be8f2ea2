"""Searches for the largest return: plans that end the episode, values at the horizon, standing."""

import numpy as np
import pytest

from flipperctl.api import ACTIONS, FloatArray, Profile, RewardTerm, action_index
from flipperctl.config import resolver
from flipperctl.lookahead.model import Model, Nodes
from flipperctl.lookahead.returns import Returns
from flipperctl.lookahead.search import Plan, Search
from flipperctl.reward_sum import RewardSum
from tests.lookahead.scenes import FLAT, ROBOT, WALL, model_of, standing

GAMMA, R, PATIENCE = 0.9, 10.0, 20
HOLD = action_index(0, 0)


def searched(
    model: Model,
    root: Nodes,
    profile: Profile,
    value: float,
    stands: int = 0,
    depth: int = 4,
    averaging: float = 0.0,
    **weights: float,
) -> Plan:
    """Search for the return of ``end`` and others, with an equal ``value`` at every horizon."""
    terms = {}
    for name, weight in {"end": 1.0, **weights}.items():
        terms[name] = resolver.create("reward", {"name": name, "weight": weight}, "rewards")
        assert isinstance(terms[name], RewardTerm)

    def horizon(nodes: Nodes) -> FloatArray:
        return np.full(len(nodes), value)

    objective = Returns(
        rewards=RewardSum(terms),
        horizon=horizon,
        gamma=GAMMA,
        profile=profile,
        robot=ROBOT,
        root=root,
        standing=stands,
        patience=PATIENCE,
        averaging=averaging,
    )
    search = Search(ROBOT, objective, width=6, depth=depth, beam_per_action=1)
    return search.run(model, root.states[0])


def test_a_plan_that_reaches_the_finish_is_chosen_and_ends_there() -> None:
    """From 0.3 m before the finish, at 0.12 m a decision, the third decision reaches it."""
    model = model_of(FLAT, finish=0.3)
    plan = searched(model, standing(model, 0.0), FLAT, value=5.0, smoothness=0.1)
    assert plan.actions == (HOLD,) * 3
    assert plan.states.shape == (4, 10)
    assert model.chassis(plan.states[-1])[0] == pytest.approx(0.3, abs=0.006)
    assert -plan.costs.min() == pytest.approx(GAMMA**2 * R)
    assert plan.costs.argmin() == HOLD


def test_every_action_has_the_cost_of_its_best_plan() -> None:
    model = model_of(FLAT, finish=0.3)
    plan = searched(model, standing(model, 0.0), FLAT, value=5.0, smoothness=0.1)
    best = GAMMA**2 * R
    for (front, rear), cost in zip(ACTIONS, plan.costs, strict=True):
        # To begin the turn of one pair costs 0.1/4; to go on with it costs nothing.
        turned = 0.025 * (abs(front) + abs(rear))
        if min(front, rear) >= 0:  # raised flippers leave the robot as fast as level ones
            assert -cost == pytest.approx(best - turned)
        assert -cost <= best - turned + 1e-9
    assert np.isfinite(plan.costs).all()


def test_a_better_value_beyond_is_preferred_to_the_finish() -> None:
    """It lowers its flippers to pass the finish above the height at which it would be reached."""
    model = model_of(FLAT, finish=0.3)
    plan = searched(model, standing(model, 0.0), FLAT, value=100.0, depth=4)
    assert len(plan.actions) == 4
    assert -plan.costs.min() == pytest.approx(GAMMA**4 * 100.0)


def test_the_value_at_the_horizon_counts_after_the_discounted_rewards() -> None:
    model = model_of(FLAT, finish=50.0)
    plan = searched(model, standing(model, 0.0), FLAT, value=-7.0, depth=2, smoothness=0.1)
    assert plan.actions == (HOLD, HOLD)
    assert -plan.costs[HOLD] == pytest.approx(GAMMA**2 * -7.0)
    raised = plan.costs[action_index(1, 0)]
    assert -raised == pytest.approx(-0.025 + GAMMA**2 * -7.0)  # it goes on turning


def test_estimates_at_smaller_depths_count_by_their_share_but_not_of_ended_plans() -> None:
    far, near = model_of(FLAT, finish=50.0), model_of(FLAT, finish=0.3)
    plan = searched(far, standing(far, 0.0), FLAT, value=8.0, depth=3, averaging=0.25)
    one, two, three = (8.0 * GAMMA**k for k in (1, 2, 3))
    assert -plan.costs[HOLD] == pytest.approx(0.25 * (0.25 * one + 0.75 * two) + 0.75 * three)
    plan = searched(near, standing(near, 0.0), FLAT, value=5.0, averaging=0.25)
    assert -plan.costs[HOLD] == pytest.approx(GAMMA**2 * R)


def test_a_robot_that_has_stood_pays_for_standing_on() -> None:
    """Between wall and stop: at patience - 1 decisions of standing, the next one is the last."""
    model = model_of(WALL)
    root = standing(model, -0.38)  # its round front touches the wall
    fresh = searched(model, root, WALL, value=4.0, depth=1)
    late = searched(model, root, WALL, value=4.0, stands=PATIENCE - 1, depth=1)
    risky = searched(model, root, WALL, value=4.0, stands=PATIENCE // 2 - 1, depth=1)
    assert -fresh.costs[HOLD] == pytest.approx(GAMMA * 4.0)
    assert -late.costs[HOLD] == pytest.approx(-R)
    assert -risky.costs[HOLD] == pytest.approx((-R + GAMMA * 4.0) / 2)
