"""What the robot's controller commands once a fault is over, and what it takes for no attitude."""

import math
from pathlib import Path

import numpy as np
import pytest

from flipperctl.core.lidar.body import attitude as rotation
from flipperctl.runtime import Attitude, Cloud, FlipperController, JointAngles, Odometry
from tests.runtime.linear import ROBOT, RULE, write
from tests.runtime.test_controller import GROUND, IN_CHASSIS, RELAXED, drive, good


@pytest.fixture
def controller(tmp_path: Path) -> FlipperController:
    file = write(tmp_path / "linear.onnx", robot=ROBOT, targets=RULE)
    return FlipperController(file, IN_CHASSIS, RELAXED)


def test_after_a_jump_of_the_clock_the_flippers_are_held_where_they_are_by_then(
    controller: FlipperController,
) -> None:
    now = drive(controller) + 30.0
    assert controller.step(now).targets is None
    moved = JointAngles(now + 0.05, -0.5, 0.6)
    answer = controller.step(now + 0.05, joints=moved)
    assert (answer.state, answer.targets) == ("waiting", (-0.5, 0.6))
    assert answer.setpoints == answer.targets


def test_after_a_fault_the_setpoints_begin_where_the_flippers_are_by_then(
    controller: FlipperController,
) -> None:
    now = drive(controller)
    for _ in range(60):  # no clouds
        now += 0.05
        answer = controller.step(now, **good(now, cloud=None))
    assert answer.state == "stopped"
    for _ in range(20):
        now += 0.05
        answer = controller.step(now, **good(now, joints=JointAngles(now, -0.5, 0.2)))
        if answer.action is not None:
            break
    assert answer.setpoints is not None
    assert abs(answer.setpoints[0] + 0.5) < 0.05
    assert answer.targets is not None
    assert abs(answer.targets[0] + 0.5) < math.pi / 12 + 0.01


def test_a_quaternion_without_an_orientation_is_refused(controller: FlipperController) -> None:
    now = drive(controller) + 0.05
    for w in (0.0, math.nan, 3.0):
        attitude = Attitude.from_quaternion(now, "base_link", 0.0, 0.0, 0.0, w, 0.0)
        controller.step(now, **good(now, attitude=attitude))
        assert controller._intake.refused("attitude").name == "attitude_value"
        now += 0.05
        controller.step(now, **good(now))
        now += 0.05


def seen(controller: FlipperController, now: float) -> np.ndarray:
    return controller._estimator.estimate(now)[0].heights


@pytest.mark.parametrize("late", ["attitude", "joints"])
def test_a_cloud_before_the_posture_is_known_does_not_enter_the_map(
    controller: FlipperController, late: str
) -> None:
    """A robot parked on a slope, in frame R level ground, would be taken for level."""
    answer = controller.step(0.0, **posture(0.0, **{late: None}))
    assert answer.fault == f"{late}_missing"
    answer = controller.step(0.05, **posture(0.05, cloud=None))
    assert answer.fault == "cloud_posture"
    assert answer.reason == f"cloud came before any {late}; one before it is allowed"
    assert controller.step(0.1, **posture(0.1)).fault == ""
    slope = math.tan(0.3) * 0.15
    assert np.diff(seen(controller, 0.1)[:6]) == pytest.approx(np.full(5, slope), abs=0.01)


def test_clouds_do_not_enter_the_map_with_an_old_attitude(controller: FlipperController) -> None:
    """While it is lost the robot may tip; by the last attitude level ground would be a slope."""
    now = drive(controller)
    for k in range(12):
        now += 0.05
        answer = controller.step(now, **(tipped if k > 1 else good)(now, attitude=None))
    assert answer.fault == "attitude_age"
    assert controller._intake.refused("cloud").name == "cloud_posture"
    now += 0.05
    assert controller.step(now, **tipped(now)).state == "driving"
    assert np.ptp(seen(controller, now)[6:]) < 0.01  # behind it, the tracks touch the ground


def posture(now: float, **changes: object) -> dict[str, object]:
    """Messages of a robot at rest on a slope of 0.3 rad."""
    told = {"attitude": Attitude(now, "base_link", 0.0, 0.3, 0.0), "odometry": Odometry(now, 0.0)}
    return good(now, **{**told, **changes})


def tipped(now: float, **changes: object) -> dict[str, object]:
    """Messages of a robot that has tipped up by 0.3 rad above level ground."""
    points = Cloud(now, "base_link", GROUND @ rotation(0.0, 0.3, 0.0))
    told = {"attitude": Attitude(now, "base_link", 0.0, 0.3, 0.0), "cloud": points}
    return good(now, **{**told, "odometry": Odometry(now, 0.025), **changes})
