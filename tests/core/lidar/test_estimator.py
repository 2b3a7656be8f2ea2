"""The estimator from messages alone, as on a robot."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.contact import clearances
from flipperctl.core.lidar.estimator import LidarEstimator, Mount
from flipperctl.core.lidar.ground import MapSettings
from flipperctl.core.lidar.messages import Joints, Pose, Scan
from flipperctl.core.sensing import Measured

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)
UP = Mount(x=0.25, z=0.4, axis=math.pi / 2, near=0.1, margin=0.02)  # frame S is level
LEVEL = Pose(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)


def estimator() -> LidarEstimator:
    return LidarEstimator(BODY, UP, MapSettings(bins=15, bin_width=0.15))


def told(robot: LidarEstimator, *values: object) -> LidarEstimator:
    for value in values:
        robot.update(Measured("device", 0.0, value))
    return robot


def ahead(error: float = 0.0) -> Scan:
    """Return points in frame S of level ground 0.5 m below it, from 0.2 to 1 m ahead."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.2, 1.0, 0.005), np.arange(-0.3, 0.31, 0.1)))
    return Scan(np.column_stack([x, y, np.full(len(x), -0.5 + error)]))


def test_level_ground_is_a_track_radius_below_the_robot_and_partly_seen() -> None:
    ground, angles = told(estimator(), LEVEL, Joints(0.1, 0.2), ahead()).estimate(0.0)
    assert ground.heights == pytest.approx(np.full(15, -0.1))
    assert (angles.front, angles.rear, angles.pitch) == (0.1, 0.2, 0.0)
    assert ground.seen is not None
    # Seen from 0.45 to 1.125 m: the bins from 0.375 m on, not those below and behind the robot.
    assert ground.seen.tolist() == [False] * 10 + [True] * 5


def test_a_pitched_robot_sees_the_same_level_ground() -> None:
    turn = 0.2
    cos, sin = math.cos(turn), math.sin(turn)
    tilted = ahead().points + np.array([0.25, 0.0, 0.4])  # in frame R of a level robot
    x, z = tilted[:, 0].copy(), tilted[:, 2].copy()
    tilted[:, 0], tilted[:, 2] = cos * x + sin * z, cos * z - sin * x
    scan = Scan(tilted - np.array([0.25, 0.0, 0.4]))
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0))
    robot.estimate(0.0)  # starts level
    told(robot, Pose(0.0, 0.0, 0.1, 0.0, turn, 0.0), scan)
    ground, _ = robot.estimate(0.0)
    assert ground.seen is not None
    assert ground.seen.sum() >= 4
    assert ground.heights[ground.seen] == pytest.approx(-0.1, abs=1e-3)


def test_the_map_remembers_ground_that_is_behind() -> None:
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead(0.2))  # a block, 0.2 m high
    robot.estimate(0.0)
    ground, _ = told(robot, Pose(1.0, 0.0, 0.3, 0.0, 0.0, 0.0)).estimate(0.0)
    assert ground.seen is not None
    assert ground.seen[4:8].all()
    assert ground.heights[4:8] == pytest.approx(-0.1, abs=0.001)


def test_points_of_the_robot_itself_and_numbers_that_are_not_finite_are_dropped() -> None:
    clean = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead()).estimate(0.0)[0]
    own = [[0.3, 0.25, -0.35], [-0.25, 0.0, -0.35]]  # on a front flipper and on the chassis
    odd = [[math.nan, 0.0, 0.0], [math.inf, 0.0, 0.0], [0.01, 0.0, 0.0]]
    scan = Scan(np.concatenate([ahead().points, np.array(10 * own + odd)]))
    bad = Pose(math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0), bad, Joints(math.inf, 0.0), scan)
    assert np.array_equal(robot.estimate(0.0)[0].points, clean.points)


@pytest.mark.parametrize("error", [0.02, -0.02])
def test_ground_seen_too_high_or_low_is_moved_to_where_the_robot_starts(error: float) -> None:
    ground, _ = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead(error)).estimate(0.0)
    assert ground.heights == pytest.approx(np.full(15, -0.1), abs=1e-6)


def test_the_clearance_is_measured_below_the_tracks_alone() -> None:
    circles = np.array([[0.0, 0.0], [0.3, 0.0]])
    flat = np.array([[0.0, -0.12], [0.05, -0.12], [0.09, 0.3]])  # the last one on a face
    found = clearances(circles, 0.1, flat)
    assert found == pytest.approx([0.02, 0.12 - 0.1 * math.sqrt(0.75), math.inf])
    assert clearances(circles, 0.1, np.array([[0.15, 0.0]])) == pytest.approx([math.inf])
    assert not len(clearances(circles, 0.1, np.zeros((0, 2))))


def test_unseen_ground_is_not_where_the_robot_is() -> None:
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0))
    robot.estimate(0.0)  # assumes ground at z = 0
    lower = Pose(0.0, 0.0, 0.05, 0.0, 0.0, 0.0)
    ground, _ = told(robot, lower).estimate(0.0)
    x, z = ground.points.T
    assert z[np.abs(x) < 0.3] == pytest.approx(-0.1, abs=0.004)
    assert z[np.abs(x) > 0.8] == pytest.approx(-0.05)


def test_a_snapshot_restores_the_map() -> None:
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead())
    first = robot.estimate(0.0)[0]
    saved = robot.save()
    told(robot, ahead(0.2), ahead(0.2)).estimate(0.0)
    robot.load(saved)
    assert np.array_equal(robot.estimate(0.0)[0].points, first.points)


def test_any_messages_give_a_finite_estimate() -> None:
    rng = np.random.default_rng(5)
    robot = estimator()
    for _ in range(200):
        scale = 10.0 ** rng.integers(-3, 7)
        points = scale * rng.standard_normal((rng.integers(0, 50), 3))
        points[rng.random(points.shape) < 0.05] = math.nan
        pose = Pose(*(rng.standard_normal(6) * scale).tolist())
        robot = told(robot, pose, Joints(*rng.uniform(-4, 4, 2).tolist()), Scan(points))
        ground, _ = robot.estimate(0.0)
        assert np.isfinite(ground.heights).all()
        assert np.isfinite(ground.points).all()
        assert (np.diff(ground.points[:, 0]) >= 0).all()
