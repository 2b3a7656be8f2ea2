"""The search: it finds what is cheap or pays most, keeps its former plan, and is repeatable."""

import math
import time

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Profile, Robot, action_index
from flipperctl.config import resolver
from flipperctl.config.reward_sum import RewardSum
from flipperctl.lookahead import Mpc
from flipperctl.lookahead.model import TARGETS, Model, Nodes
from flipperctl.lookahead.mpc import HandSetCost
from flipperctl.lookahead.search import Plan, Returns, Search, moves
from tests.lookahead.scenes import FLAT, WALL, model_of, standing

ROBOT = Robot()
STEP = np.array([[0.0, 0.0], [0.0, 0.3], [3.0, 0.3]])
HOLD = action_index(0, 0)


def search(
    model: Model,
    root: np.ndarray,
    width: int,
    depth: int,
    each: int = 0,
    former: tuple[int, ...] = (),
    deadline: float = math.inf,
    robot: Robot = ROBOT,
) -> Plan:
    """Search for the least hand-set cost."""
    account = HandSetCost(settings=Mpc(value=""), robot=robot, begin=model.chassis(root)[0])
    return Search(robot, width, depth, each).run(model, root, account, former, deadline)


def before_the_step() -> tuple[Model, np.ndarray]:
    model = Model(STEP, ROBOT)
    return model, model.state((-0.75, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))


def test_it_holds_level_flippers_on_level_ground_and_raises_the_front_ones_before_a_step() -> None:
    model = Model(np.array([[0.0, 0.0]]), ROBOT)
    level = search(model, model.state((0.0, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0)), 6, 4)
    assert level.actions == (HOLD,) * 4
    assert level.lost_time < 0.1
    model, root = before_the_step()
    plan = search(model, root, 8, 6)
    assert sum(ACTIONS[action][0] for action in plan.actions[:3]) >= 2
    assert plan.states[-1][0] > root[0] + 0.3


def test_the_cheapest_first_action_is_that_of_the_plan_and_a_wider_beam_is_no_worse() -> None:
    model, root = before_the_step()
    narrow, wide, again = (search(model, root, width, 5) for width in (4, 32, 32))
    for plan in (narrow, wide):
        assert plan.costs.argmin() == plan.actions[0]
    assert wide.costs.min() <= narrow.costs.min()
    assert wide.simulated > narrow.simulated
    assert wide.actions == again.actions
    assert np.array_equal(wide.costs, again.costs)
    assert len(search(model, root, 8, 6, deadline=time.perf_counter() - 1.0).actions) == 1


def test_every_action_has_a_cost_if_nodes_of_each_are_kept() -> None:
    """Without, the beam soon follows one first action, and the others' costs are unknown."""
    model, root = before_the_step()
    alone, every = (search(model, root, 4, 6, n).costs for n in (0, 2))
    assert np.isinf(alone).sum() >= 5
    assert np.isfinite(every).all()
    assert every.min() <= alone.min() + 1e-9
    raise_front, lower_front = (every[action_index(i, 0)] for i in (1, -1))
    assert raise_front < lower_front


def test_a_former_plan_stays_in_the_beam() -> None:
    model = Model(STEP, ROBOT)
    root = model.state((-0.3, 0.45, 0.35), (0.8, -0.5), (0.1, 0.1, 0.0))  # on the edge, nose up
    good, blind = (search(model, root, width, 6) for width in (32, 1))
    kept = search(model, root, 1, 6, former=good.actions)
    assert blind.costs.min() > good.costs.min()
    assert kept.costs.min() <= good.costs.min() + 1e-9


def test_where_every_action_overturns_it_takes_the_least_dangerous() -> None:
    model = Model(np.array([[0.0, 0.0]]), ROBOT, overturn=0.5)
    root = model.state((0.0, 0.6, 0.49), (0.0, 0.0), (0.0, 0.0, 3.0))
    assert len(search(model, root, 4, 3).actions) == 1


def test_small_turns_are_plans_of_their_own() -> None:
    robot = Robot(angle_step=0.03)
    model = Model(STEP, robot)
    root = model.state((-0.75, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))
    assert np.isfinite(search(model, root, 8, 4, 3, robot=robot).costs).all()


def test_targets_begin_at_most_a_turn_from_the_flippers() -> None:
    """As the robot's do; with a short period they would run ahead of the flippers."""
    state = Model(STEP, ROBOT).state((-0.75, 0.1, 0.0), (0.1, 0.0))
    state[TARGETS] = 0.9
    _, action, targets = moves(state[None], ROBOT)
    step = ROBOT.angle_step
    raised, held = (targets[action == action_index(turn, 0)][0, 0] for turn in (1, 0))
    assert (held, raised) == pytest.approx((0.1 + step, 0.1 + 2 * step))


# The largest return: plans that end the episode, values at the horizon, standing

GAMMA, R, PATIENCE = 0.9, 10.0, 20


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
    terms = {
        name: resolver.create("reward", {"name": name, "weight": weight}, "rewards")
        for name, weight in {"end": 1.0, **weights}.items()
    }
    account = Returns(
        rewards=RewardSum(terms),
        horizon=lambda nodes: np.full(len(nodes), value),
        gamma=GAMMA,
        profile=profile,
        robot=ROBOT,
        nodes=root,
        begin=root.places[0, 0],
        standing=stands,
        patience=PATIENCE,
        averaging=averaging,
    )
    return Search(ROBOT, 6, depth, 1).run(model, root.states[0], account)


def test_a_plan_that_reaches_the_finish_is_chosen_and_ends_there() -> None:
    """From 0.3 m before the finish, at 0.12 m a decision, the third decision reaches it."""
    model = model_of(FLAT, finish=0.3)
    plan = searched(model, standing(model, 0.0), FLAT, value=5.0, smoothness=0.1)
    assert plan.actions == (HOLD,) * 3
    assert plan.states.shape == (4, 10)
    assert model.chassis(plan.states[-1])[0] == pytest.approx(0.3, abs=0.006)
    assert -plan.costs.min() == pytest.approx(GAMMA**2 * R)
    assert plan.costs.argmin() == HOLD
    # To begin the turn of one pair costs 0.1/4; raised flippers leave the robot as fast.
    for (front, rear), cost in zip(ACTIONS, plan.costs, strict=True):
        best = GAMMA**2 * R - 0.025 * (abs(front) + abs(rear))
        assert -cost <= best + 1e-9
        assert min(front, rear) < 0 or -cost == pytest.approx(best)


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
    fresh, late, risky = (
        searched(model, root, WALL, value=4.0, stands=stands, depth=1)
        for stands in (0, PATIENCE - 1, PATIENCE // 2 - 1)
    )
    assert -fresh.costs[HOLD] == pytest.approx(GAMMA * 4.0)
    assert -late.costs[HOLD] == pytest.approx(-R)
    assert -risky.costs[HOLD] == pytest.approx((-R + GAMMA * 4.0) / 2)
