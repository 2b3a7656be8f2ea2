"""A flipper that cannot follow its command."""

import math

import pytest

from flipperctl.api import action_index
from flipperctl.env.flipper_env import FlipperEnv

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


def test_a_freed_flipper_turns_no_farther_than_its_last_command() -> None:
    env = start(torque=60.0)
    for _ in range(4):
        env.step(LOWER)
    env.step(HOLD)  # one angle step from where it is
    env.drive.world.load(  # lifted into the air, where nothing blocks it
        lifted(env.drive.world.save())
    )
    env.step(HOLD)
    assert env.state.front == pytest.approx(-STEP, abs=0.02)
    assert env.state.rear == pytest.approx(-STEP, abs=0.02)


def lifted(saved: tuple) -> tuple:
    """Return a snapshot of the world with the robot 5 m above the ground."""
    bodies, *rest = saved
    return ([((p[0], p[1] + 5.0), *others) for p, *others in bodies], *rest)


def test_a_flipper_that_follows_keeps_the_exact_grid_of_angles() -> None:
    env = start(torque=200.0)
    for count in range(1, 5):
        env.step(RAISE)
        assert env.drive.targets == (sum([STEP] * count), sum([STEP] * count))
    assert env.state.front != env.drive.targets[0]  # the servo's error stays out of the targets
