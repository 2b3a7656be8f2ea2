"""What the estimator assumes at the start, and the constant errors that it estimates there."""

import math
from dataclasses import replace

import numpy as np
import pytest

from flipperctl.core.lidar.certainty import Accuracy
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapSettings
from flipperctl.core.lidar.messages import Inertial, Joints, Pose, Scan
from flipperctl.core.sensing import Measured
from tests.core.lidar.level_ground import BODY, LEVEL, UP, ahead, estimator, told


@pytest.mark.parametrize("error", [0.02, -0.02])
def test_ground_seen_too_high_or_low_is_moved_to_where_the_robot_starts(error: float) -> None:
    ground, _ = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead(error)).estimate(0.0)
    # Mostly: the robot takes it for an error of the distances, which counts less further ahead.
    assert ground.heights[:12] == pytest.approx(np.full(12, -0.1), abs=0.003)
    assert ground.heights[12:] == pytest.approx(np.full(3, -0.1), abs=abs(error) / 2)


@pytest.mark.parametrize("error", [0.02, -0.02])
def test_distances_that_are_all_too_long_or_short_are_corrected(error: float) -> None:
    true = ahead().points
    distance = np.linalg.norm(true, axis=1, keepdims=True)
    scan = Scan(true * (1 + error / distance))
    ground, _ = told(estimator(), LEVEL, Joints(0.0, 0.0), scan).estimate(0.0)
    assert ground.heights == pytest.approx(np.full(15, -0.1), abs=5e-4)


def test_a_pitch_that_errs_at_the_start_is_corrected_there_and_less_later() -> None:
    settings = MapSettings(bins=15, bin_width=0.15, accuracy=Accuracy(tilt=0.02))
    robot = LidarEstimator(BODY, UP, settings)
    level = Inertial(0.0, 0.01, 0.0)  # of a robot that is level in truth
    for time in (0.0, 0.01, 30.0):
        told_at = [Measured("unit", time, level), Measured("joints", time, Joints(0.0, 0.0))]
        for message in [*told_at, Measured("lidar", time, ahead())][: 3 if time < 0.01 else 2]:
            robot.update(message)
        pitch = robot.estimate(time)[1].pitch
        if time == 0.01:
            assert abs(pitch) < 0.001
    assert pitch == pytest.approx(0.01 * (1 - math.exp(-1)), abs=0.001)


def test_a_robot_that_may_stand_on_an_obstacle_assumes_no_ground() -> None:
    turn = 0.4
    for level in (True, False):
        settings = MapSettings(bins=15, bin_width=0.15)
        robot = LidarEstimator(BODY, UP, settings, level=level)
        told(robot, Pose(0.0, 0.0, 0.3, 0.0, turn, 0.0), Joints(0.0, 0.0))
        rear = robot.estimate(0.0)[0].heights[0]
        assert bool(abs(rear + 0.55) < 0.01) is level  # the slope of the chassis


@pytest.mark.parametrize("pitch", [0.35, 0.05, -0.05, -0.35])
def test_a_robot_that_starts_on_a_slope_assumes_the_slope_behind_it(pitch: float) -> None:
    robot = told(estimator(), Pose(0.0, 0.0, 0.3, 0.0, pitch, 0.0), Joints(0.0, 0.0))
    below = 0.1 / math.cos(pitch)
    bins = (np.arange(15) - 7) * 0.15
    heights = robot.estimate(0.0)[0].heights
    for x, height in zip(bins, heights, strict=True):
        if x < 0.28 - 0.15:  # behind the front hinge
            assert height == pytest.approx(math.tan(pitch) * x - below, abs=0.012), x
    turned = told(robot, ahead(0.05))  # it takes no bias of the range from that
    assert turned._errors.distance == turned._errors.pitch == 0.0


@pytest.mark.parametrize("yaw", [math.pi / 2, math.pi, -2.5])
def test_ground_is_assumed_behind_the_start_whichever_way_it_faces(yaw: float) -> None:
    """A tracking system's frame begins anywhere."""
    found = []
    for x, y, heading in ((0.0, 0.0, 0.0), (3.0, -2.0, yaw)):
        robot = told(estimator(), replace(LEVEL, x=x, y=y, yaw=heading), Joints(0.0, 0.0))
        robot.estimate(0.0)
        block = ahead(0.2).points
        hidden = (block[:, 0] > 0.45) & (block[:, 0] < 0.7)
        found.append(told(robot, Scan(block[~hidden])).estimate(0.0)[0].heights)
    assert found[0][:7] == pytest.approx(-0.1)
    assert found[0][12:] == pytest.approx(0.1, abs=0.01)  # of the block, also where it is hidden
    assert found[1] == pytest.approx(found[0], abs=0.02)


def test_a_robot_that_has_turned_back_is_on_another_storey() -> None:
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0))
    robot.estimate(0.0)
    heights = told(robot, Pose(0.2, 1.0, 3.1, 0.0, 0.0, math.pi), ahead()).estimate(0.0)[0].heights
    assert heights == pytest.approx(np.full(15, -0.1), abs=0.01)


def test_a_robot_that_its_flippers_turn_stands_on_level_ground() -> None:
    robot = told(estimator(), Pose(0.0, 0.0, 0.11, 0.0, 0.05, 0.0), Joints(-0.1, 0.0))
    heights = robot.estimate(0.0)[0].heights
    assert heights[:7] == pytest.approx(heights[0])


@pytest.mark.parametrize("rise", [0.1, -0.1])
def test_a_first_scan_of_ground_elsewhere_takes_level_ground_and_errors_back(rise: float) -> None:
    """As on a landing at whose edge the robot starts, or on rough ground."""
    told_of = LEVEL, Joints(0.0, 0.0), ahead(rise)
    robot = told(estimator(), *told_of)
    assert robot._errors.distance == robot._errors.pitch == 0.0
    heights, known = robot.estimate(0.0)[0].heights, range(11, 15)
    assert heights[known] == pytest.approx(np.full(4, rise - 0.1), abs=0.005)
    assumed = LidarEstimator(BODY, UP, MapSettings(bins=15, bin_width=0.15), level=False)
    assert heights == pytest.approx(told(assumed, *told_of).estimate(0.0)[0].heights)


def test_raised_flippers_in_the_first_scan_are_no_ground_elsewhere() -> None:
    x, z = np.meshgrid(np.linspace(0.3, 0.45, 200), [0.1, 0.12, 0.14])  # of the front flippers
    own = np.column_stack([x.ravel(), np.full(x.size, 0.3), z.ravel()]) - (0.25, 0.0, 0.4)
    scan = Scan(np.vstack([ahead().points, own]))
    ground, _ = told(estimator(), LEVEL, Joints(0.4, 0.0), scan).estimate(0.0)
    assert ground.heights == pytest.approx(np.full(15, -0.1), abs=0.005)
