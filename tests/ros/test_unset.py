"""Orientations of 0 0 0 1 and speeds of 0 that no driver filled in, beside true ones."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from flipperctl.ros.reading import Pose
from flipperctl.ros.topics import orientations, speed_unset

LEVEL = 0.0, 0.0, 0.0, 1.0


def xyz(x=0.0, y=0.0, z=0.0):
    return SimpleNamespace(x=x, y=y, z=z)


def pitched(angle):
    return 0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)


def imu(tick, turn=LEVEL, rate=0.0, gravity=0.0, covariance=0.0):
    """A message at 100 Hz; ``gravity``: how far the unit is really pitched."""
    stamp = SimpleNamespace(sec=1, nanosec=tick * 10**7)
    q = SimpleNamespace(**dict(zip("xyzw", turn, strict=True)))
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id="imu"),
        orientation=q,
        orientation_covariance=[covariance] + [0.0] * 8,
        angular_velocity=xyz(y=rate),
        linear_acceleration=xyz(-9.81 * math.sin(gravity), 0.0, 9.81 * math.cos(gravity)),
        linear_acceleration_covariance=[0.0] * 9,
    )


def climbing(time):
    """The chassis, which pitches by 0.3 rad in a second."""
    return Pose(np.array([0.2 * time, 0, 0]), np.array(pitched(0.3 * (time - 1))))


def standing(time):
    return Pose.none()


@pytest.mark.parametrize(
    ("messages", "chassis", "mount", "reason"),
    [
        ([imu(i, rate=0.3) for i in range(90)], standing, None, "its rates tilt by 0.2. rad"),
        ([imu(i, covariance=0.01) for i in range(90)], climbing, None, "poses .* tilt by 14°"),
        ([imu(i, gravity=0.5) for i in range(90)], standing, None, "gravity is 29° from its z"),
        ([imu(i) for i in range(90)], standing, pitched(1.0), "it is mounted at 57°"),
        (
            [imu(i, pitched(0.3) if i % 2 else LEVEL) for i in range(90)],
            standing,
            None,
            "jumps between level and 0.30 rad",
        ),
    ],
)
def test_a_level_orientation_is_none_if_something_contradicts_it(messages, chassis, mount, reason):
    mounted = mount and Pose(np.zeros(3), np.array(mount))
    found = orientations(messages, chassis, mounted)
    assert found.level == sum(one.orientation.y == 0 for one in messages)
    assert not found.told(imu(0))
    assert found.told(imu(0, pitched(0.3)))
    assert re.search(reason, found.reason), found.reason


@pytest.mark.parametrize(
    "messages",
    [
        [imu(i, rate=(-1) ** i * 0.02) for i in range(99)],  # noise of a gyroscope
        [imu(i, rate=0.01) for i in range(99)],  # its error
        # It is level, and climbs then, as in a simulator without noise.
        [imu(i, pitched(0.003 * max(0, i - 50)), 0.3 * (i > 50)) for i in range(99)],
    ],
)
def test_a_robot_may_be_level(messages):
    found = orientations(messages, standing, Pose.none())
    assert (found.level, found.doubtful) == (0, messages[-1].orientation.y == 0)


def test_messages_without_orientation_are_counted():
    messages = [imu(0, covariance=-1), imu(1, (0.0, 0.0, 0.0, 0.0)), imu(2)]
    found = orientations(messages, standing, None)
    assert (found.messages, found.blank, found.level) == (3, 2, 0)
    assert [found.told(one) for one in messages] == [False, False, True]


def speeds(told, place=lambda time: 0.2 * time, noise=0.0):
    """Messages at 10 Hz for 10 s."""
    rng = np.random.default_rng(0)
    for time in np.arange(0, 10, 0.1).tolist():
        yield time, told(time), np.array([place(time), 0, 0]) + noise * rng.normal(size=3)


@pytest.mark.parametrize(
    ("messages", "reason"),
    [
        (
            speeds(lambda t: 0.0 if t < 5 else 0.2),
            "its speed is 0 in 50 of 100 messages while its pose moves 1.0 m",
        ),
        (speeds(lambda t: 0.0 if round(10 * t) % 2 else 0.2), "in 50 of 100 .* 2.0 m"),
        # A robot that stands, by a pose with noise; one that starts late, and stops in between.
        (speeds(lambda t: 0.0, place=lambda t: 0.0, noise=0.02), ""),
        (speeds(lambda t: 0.2 * (t > 3), place=lambda t: 0.2 * max(0, t - 3)), ""),
        (
            speeds(lambda t: 0.2 * (t % 2 > 1), place=lambda t: 0.2 * (t // 2 + max(0, t % 2 - 1))),
            "",
        ),
        # Coarse encoders: 0.4 m/s and 0 in turns.
        (speeds(lambda t: 0.0 if round(10 * t) % 2 else 0.4), ""),
        (((t, s, None) for t, s, _ in speeds(lambda t: 0.0)), "recorded poses move 2.0 m"),
    ],
)
def test_a_speed_of_0_is_none_while_poses_move(messages, reason):
    def moving(time):
        return Pose(np.array([0.2 * time, 0, 0]), np.array(LEVEL))

    chassis = moving if "recorded" in reason else (lambda time: None)
    found = speed_unset(messages, chassis)
    assert re.search(reason, found) if reason else found == ""
