"""The physical part of an episode: blocked flippers, the time of a decision, and standing still."""

import math

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Outcome, Profile, Robot, action_index
from flipperctl.config import Episode
from flipperctl.core.targets import as_action
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.termination import Termination

STEP = math.pi / 12
LOWER, HOLD, RAISE = (action_index(turn, turn) for turn in (-1, 0, 1))


def start(torque: float) -> FlipperEnv:
    env = FlipperEnv(
        {"name": "flat"},
        robot={"flipper_torque": torque},
        episode={"start_noise": 0.0, "start_angle": 0.0},
    )
    env.reset(seed=0)
    return env


# 65.9 N m would lift the robot (test_world.py).
def test_a_blocked_flipper_starts_from_where_it_is() -> None:
    env = start(torque=60.0)
    for expected in (-STEP, -2 * STEP, -2 * STEP, -2 * STEP):
        env.step(LOWER)
        assert env.drive.targets == pytest.approx((expected, expected), abs=0.01)
        assert env.state.front == pytest.approx(0.0, abs=0.01)
    env.step(RAISE)  # it pushes no longer
    assert env.drive.targets == pytest.approx((0.0, 0.0), abs=0.01)
    env.step(RAISE)
    assert env.state.front == pytest.approx(STEP, abs=0.01)
    assert env.state.rear == pytest.approx(STEP, abs=0.01)


def test_a_flipper_that_follows_keeps_the_exact_grid_of_angles() -> None:
    env = start(torque=200.0)
    for count in range(1, 5):
        env.step(RAISE)
        assert env.drive.targets == (sum([STEP] * count), sum([STEP] * count))
    assert env.state.front != env.drive.targets[0]  # the servo's error stays out of the targets


@pytest.mark.parametrize(("period", "turned"), [(0.3, 7.5), (1.2, 15.0)])
def test_a_flipper_turns_at_its_own_speed_whatever_the_period(period: float, turned: float) -> None:
    env = FlipperEnv("flat", robot={"control_period": period})
    env.reset(seed=0)
    env.step(action_index(1, 0))
    assert env.state.time == pytest.approx(period)
    assert math.degrees(env.state.front) == pytest.approx(turned, abs=0.5)
    env.step(action_index(0, 0))  # and reaches the angle that the first action commanded
    assert math.degrees(env.state.front) == pytest.approx(15.0, abs=0.5)


@pytest.mark.parametrize(
    ("settings", "period", "decisions"),
    [
        ({}, 0.6, 20),
        ({}, 0.3, 20),
        ({"stuck_window": 5}, 0.3, 5),
        ({"stuck_time": 3.0}, 0.6, 5),
        ({"stuck_time": 3.0}, 0.3, 10),
        ({"stuck_time": 0.1}, 0.6, 2),  # progress is measured over two decisions at least
    ],
)
def test_a_robot_that_stands_is_stuck(
    settings: dict[str, float], period: float, decisions: int
) -> None:
    termination = Termination(Profile([(1.0, 0.0)]), Robot(), Episode(**settings), 0.0, period)
    found = [termination.after_decision(0.0) for _ in range(decisions)]
    assert found == [None] * (decisions - 1) + [Outcome.STUCK]


def test_limits_count_the_decisions_as_long_as_they_last() -> None:
    """A period that is no multiple of the sample period is rounded up to one."""
    env = FlipperEnv("flat", robot={"control_period": 0.011}, episode={"stuck_time": 3.0})
    env.reset(seed=0)
    env.step(action_index(0, 0))
    assert env.state.time == pytest.approx(0.02)
    whole = FlipperEnv("flat", robot={"control_period": 0.02}, episode={"stuck_time": 3.0})
    whole.reset(seed=0)
    limits, exact = (e.drive.termination for e in (env, whole))
    assert limits.t_max == exact.t_max
    assert limits._trail.maxlen == exact._trail.maxlen


def test_rates_of_whole_steps_are_the_nine_actions_and_others_turn_by_parts() -> None:
    turned, rated = FlipperEnv("step"), FlipperEnv("step", actions="rates")
    assert rated.action_space.shape == (2,)
    for env in (turned, rated):
        env.reset(seed=3)
    for index, rates in enumerate(ACTIONS):
        by_index, by_rates = turned.step(index), rated.step(np.array(rates, np.float32))
        assert by_index[0].tobytes() == by_rates[0].tobytes()
        assert by_index[1:] == by_rates[1:]
    front, rear = rated.drive.targets
    rated.step((0.4, -0.6))
    step = rated.robot.angle_step
    assert rated.drive.targets == pytest.approx((front + 0.4 * step, rear - 0.6 * step))
    assert rated.drive.action == action_index(0, -1)  # the closest of the nine
    assert rated.drive.rates == (0.4, -0.6)


@pytest.mark.parametrize("rates", [(1, -1), [1, -1.0], np.array([1, -1])])
def test_rates_may_be_whole_numbers(rates: object) -> None:
    assert as_action(rates) == (1.0, -1.0)
