"""The time between two decisions, and the time after which a robot that stands is stuck."""

import math

import pytest

from flipperctl.api import Outcome, Profile, Robot, action_index
from flipperctl.config import Episode
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.termination import Termination


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
