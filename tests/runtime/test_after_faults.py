"""What the robot's controller commands once a fault is over, and what it takes for no attitude."""

import math
from pathlib import Path

import pytest

from flipperctl.runtime import Attitude, FlipperController, JointAngles
from tests.runtime.linear import ROBOT, RULE, write
from tests.runtime.test_controller import IN_CHASSIS, RELAXED, drive, good


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
