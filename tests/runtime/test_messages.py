"""Messages as drivers send them: attitudes, parts of the joints, orientations that no one fills."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flipperctl.core.lidar.messages import Belts, Inertial, checked
from flipperctl.runtime import Attitude, Limits, NewestJoints, RobotSetup, intake
from flipperctl.runtime.intake import Intake


@pytest.mark.parametrize(
    ("roll", "pitch", "rates"),
    [
        (0.0, 0.0, (0.3, -0.2, 0.5)),
        (0.14, 0.0, (0.0, -0.5, 0.0)),  # it leans and lifts its nose: no turn about z alone
        (0.2, -0.6, (0.1, 0.2, -0.3)),
        (-0.3, 0.7, (0.0, 0.4, 0.4)),
    ],
)
def test_the_rates_about_its_axes_give_the_turn_of_its_heading(
    roll: float, pitch: float, rates: tuple[float, float, float]
) -> None:
    now = Rotation.from_euler("ZYX", [0.4, pitch, roll])
    told = Attitude.from_imu(0.0, "base_link", tuple(now.as_quat()), rates)
    step = 1e-6
    later = now * Rotation.from_rotvec(step * np.array(rates))
    turn = (later.as_euler("ZYX")[0] - now.as_euler("ZYX")[0]) / step
    assert told.yaw_rate == pytest.approx(turn, abs=1e-5)
    assert told.pitch == pytest.approx(pitch)  # nose down positive


def test_a_unit_on_end_or_without_orientation_gives_no_infinite_turn() -> None:
    half = math.sqrt(0.5)
    upright = Attitude.from_imu(0.0, "base_link", (0.0, half, 0.0, half), (1.0, 1.0, 1.0))
    assert math.isfinite(upright.yaw_rate)
    none = Attitude.from_imu(0.0, "base_link", (0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert math.isnan(none.roll)

    for w in (0.0, math.nan, 3.0):
        message = Attitude.from_quaternion(1.0, "base_link", 0.0, 0.0, 0.0, w, 0.0)
        received = Intake(RobotSetup(), Limits())
        assert list(received.receive(1.0, attitude=message)) == []
        assert received.refused("attitude").name == "attitude_value"


def test_each_joint_counts_with_its_newest_angle_and_the_oldest_stamp():
    joints = NewestJoints(("a", "b"), ("c", "d"))
    assert joints.take(1.0, ["a", "b", "elbow"], [0.1, 0.3, 9.0]) is None
    assert joints.take(1.1, ["c"], [0.5]) is None
    found = joints.take(1.2, ["d"], [0.7])
    assert (found.time, found.front, found.rear) == (1.0, 0.2, 0.6)
    assert joints.take(1.3, ["elbow"], [9.0]) is None
    found = joints.take(1.4, ["b", "a"], [0.5])  # a joint without a position is none
    assert (found.time, found.front) == (1.0, 0.3)
    found = joints.take(math.nan, ["b"], [0.5])
    assert math.isnan(found.time)  # without a stamp, which the intake refuses


def test_what_passes_the_intake_passes_the_estimator() -> None:
    assert checked(0.0, Belts(intake._FASTEST)) is not None
    assert checked(0.0, Inertial(0.0, 0.0, intake._FASTEST_TURN)) is not None


LEVEL, UP = (0.0, 0.0, 0.0, 1.0), (0.0, -0.1, 0.0, 0.99498744)


def received(turns, rate):
    """The faults after each message of a unit at 100 Hz."""
    intake = Intake(RobotSetup(), Limits())
    for tick, turn in enumerate(turns):
        time = 1 + 0.01 * tick
        message = Attitude.from_imu(time, "base_link", turn, (0.0, rate, 0.0))
        list(intake.receive(time, attitude=message))
        yield intake.refused("attitude")


def test_an_orientation_that_the_rates_contradict_is_refused_from_then_on():
    faults = list(received([LEVEL] * 70 + [UP, LEVEL], 0.3))
    assert faults[0] is None
    assert faults[69].name == "attitude_rates"
    assert "change of tilt, attitude against turn rates: 0.15 rad" in faults[69].reason
    assert faults[70] == faults[71] == faults[69]


def test_an_orientation_that_gravity_contradicts_is_refused():
    intake = Intake(RobotSetup(), Limits())
    for tick in range(200):
        message = Attitude.from_imu(0.01 * tick, "base_link", LEVEL, (0, 0, 0), (3.0, 0.0, 9.3))
        list(intake.receive(0.01 * tick, attitude=message))
    assert intake.refused("attitude").name == "attitude_gravity"


@pytest.mark.parametrize("rate", [0.0, 0.02])
def test_a_robot_on_level_ground_is_not(rate):
    assert set(received([LEVEL] * 300, rate)) == {None}
