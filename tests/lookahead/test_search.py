"""The search: it finds what is cheap, keeps its former plan, and is repeatable."""

import time

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Robot, action_index
from flipperctl.lookahead.controllers import Mpc
from flipperctl.lookahead.model import TARGETS, Model
from flipperctl.lookahead.search import Search, moves

ROBOT = Robot()
STEP = np.array([[0.0, 0.0], [0.0, 0.3], [3.0, 0.3]])
HOLD = action_index(0, 0)


def before_the_step() -> tuple[Model, np.ndarray]:
    model = Model(STEP, ROBOT)
    return model, model.state((-0.75, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))


def test_on_level_ground_it_holds_level_flippers_still() -> None:
    model = Model(np.array([[0.0, 0.0]]), ROBOT)
    root = model.state((0.0, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))
    plan = Search(ROBOT, Mpc().cost_weights(ROBOT), width=6, depth=4).run(model, root)
    assert plan.actions == (HOLD,) * 4
    assert plan.lost_time < 0.1


def test_before_a_step_it_raises_the_front_flippers() -> None:
    model, root = before_the_step()
    plan = Search(ROBOT, Mpc().cost_weights(ROBOT), width=8, depth=6).run(model, root)
    raised = sum(ACTIONS[action][0] for action in plan.actions[:3])
    assert raised >= 2
    assert plan.states[-1][0] > root[0] + 0.3


def test_the_cheapest_first_action_is_that_of_the_plan_and_a_wider_beam_is_no_worse() -> None:
    model, root = before_the_step()
    narrow, wide = (
        Search(ROBOT, Mpc().cost_weights(ROBOT), w, 5).run(model, root) for w in (4, 32)
    )
    for plan in (narrow, wide):
        assert plan.costs.argmin() == plan.actions[0]
    assert wide.costs.min() <= narrow.costs.min()
    assert wide.simulated > narrow.simulated


def test_every_action_has_a_cost_if_nodes_of_each_are_kept() -> None:
    """Without, the beam soon follows one first action, and the others' costs are unknown."""
    model, root = before_the_step()
    alone, every = (
        Search(ROBOT, Mpc().cost_weights(ROBOT), 4, 6, n).run(model, root).costs for n in (0, 2)
    )
    assert np.isinf(alone).sum() >= 5
    assert np.isfinite(every).all()
    assert every.min() <= alone.min() + 1e-9
    raise_front, lower_front = (every[action_index(i, 0)] for i in (1, -1))
    assert raise_front < lower_front


def test_a_former_plan_stays_in_the_beam() -> None:
    model = Model(STEP, ROBOT)
    root = model.state((-0.3, 0.45, 0.35), (0.8, -0.5), (0.1, 0.1, 0.0))  # on the edge, nose up
    good = Search(ROBOT, Mpc().cost_weights(ROBOT), 32, 6).run(model, root)
    blind = Search(ROBOT, Mpc().cost_weights(ROBOT), 1, 6).run(model, root)
    kept = Search(ROBOT, Mpc().cost_weights(ROBOT), 1, 6).run(model, root, former=good.actions)
    assert blind.costs.min() > good.costs.min()
    assert kept.costs.min() <= good.costs.min() + 1e-9


def test_it_repeats_itself_and_ends_at_its_deadline() -> None:
    model, root = before_the_step()
    search = Search(ROBOT, Mpc().cost_weights(ROBOT), 8, 6)
    first, second = (search.run(model, root) for _ in range(2))
    assert first.actions == second.actions
    assert np.array_equal(first.costs, second.costs)
    hasty = search.run(model, root, deadline=time.perf_counter() - 1.0)
    assert len(hasty.actions) == 1


def test_where_every_action_overturns_it_takes_the_least_dangerous() -> None:
    model = Model(np.array([[0.0, 0.0]]), ROBOT, overturn=0.5)
    root = model.state((0.0, 0.6, 0.49), (0.0, 0.0), (0.0, 0.0, 3.0))
    plan = Search(ROBOT, Mpc().cost_weights(ROBOT), 4, 3).run(model, root)
    assert len(plan.actions) == 1


def test_small_turns_are_plans_of_their_own() -> None:
    robot = Robot(angle_step=0.03)
    model = Model(STEP, robot)
    root = model.state((-0.75, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))
    costs = Search(robot, Mpc().cost_weights(robot), 8, 4, 3).run(model, root).costs
    assert np.isfinite(costs).all()


def test_targets_begin_at_most_a_turn_from_the_flippers() -> None:
    """As the robot's do; with a short period they would run ahead of the flippers."""
    state = Model(STEP, ROBOT).state((-0.75, 0.1, 0.0), (0.1, 0.0))
    state[TARGETS] = 0.9
    _, action, targets = moves(state[None], ROBOT)
    step = ROBOT.angle_step
    raised, held = (targets[action == action_index(turn, 0)][0, 0] for turn in (1, 0))
    assert (held, raised) == pytest.approx((0.1 + step, 0.1 + 2 * step))
