"""The estimator from messages alone, as on a robot."""

import math
from dataclasses import astuple

import numpy as np
import pytest

from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import GroundSeen, clearances
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, PerceptionError, Pose, Scan
from flipperctl.core.lidar.scans import advanced
from flipperctl.core.sensing import Measured
from tests.core.lidar.level_ground import LEVEL, ahead, estimator, told


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


def test_an_estimate_needs_messages_that_are_not_too_old() -> None:
    with pytest.raises(PerceptionError, match="nothing was measured yet"):
        estimator().estimate(0.0)
    robot = reckoned((0.0, Belts(0.2)), (0.0, Joints(0.0, 0.0)), (0.0, ahead()))
    now, later = (robot.estimate(time)[0].deviation for time in (0.0, 2.0))
    assert now is not None
    assert later is not None
    assert (later[10:] > now[10:] + 0.05).all()  # it may have moved by 0.4 m
    with pytest.raises(PerceptionError, match=r"the newest message is 12 s old"):
        robot.estimate(12.0)
    with pytest.raises(PerceptionError, match="the time of an estimate is nan"):
        robot.estimate(math.nan)


def test_ground_on_one_side_is_told_apart() -> None:
    points = ahead().points
    points[points[:, 1] > 0, 2] += 0.1  # a kerb below the left track
    ground, _ = told(estimator(), LEVEL, Joints(0.0, 0.0), Scan(points)).estimate(0.0)
    assert ground.sides is not None
    left, right = ground.sides
    assert np.isnan(left[:9]).all()  # never seen
    assert (left - right)[11:14] == pytest.approx(0.1, abs=1e-3)
    assert right[11:14] == pytest.approx(-0.1, abs=0.005)


def test_a_full_scan_is_thinned_and_gives_the_same_ground() -> None:
    points = np.repeat(ahead().points, 30, axis=0)
    ground, _ = told(estimator(), LEVEL, Joints(0.0, 0.0), Scan(points)).estimate(0.0)
    assert len(points) > 28_800
    assert ground.heights == pytest.approx(np.full(15, -0.1), abs=1e-4)


def test_the_sectors_of_a_turn_share_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[int] = []
    add = GroundSeen.add
    monkeypatch.setattr(
        GroundSeen, "add", lambda self, p, *at: (used.append(len(p)), add(self, p, *at))
    )
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0))
    beyond = ahead().points + np.array([0.8, 0.0, 0.0])  # none of the robot's own
    scan = Scan(np.repeat(beyond, 15, axis=0))
    for time in (1.0, 1.1, 1.1125, 1.1125):
        robot.update(Measured("device", time, scan))
    assert used == [10_000, 10_000, 1250, 500]
    twin = estimator()
    twin.load(robot.save())
    twin.update(Measured("device", 1.125, scan))
    assert used[-1] == 1250


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


def reckoned(*messages: tuple[float, object]) -> LidarEstimator:
    robot = estimator()
    for time, value in messages:
        robot.update(Measured("device", time, value))
    return robot


def test_odometry_moves_along_the_chassis_and_turns_with_the_yaw_rate() -> None:
    pose = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    up = advanced(pose, Inertial(0.0, math.pi / 6, 0.0), 0.2, 0.1)
    assert (up.x, up.y, up.z) == pytest.approx((0.02 * math.sqrt(0.75), 0.0, 0.01))
    assert up.pitch == math.pi / 6
    left = advanced(pose, Inertial(0.0, 0.0, math.pi), 0.2, 0.5)
    assert (left.yaw, left.x, left.y) == pytest.approx((math.pi / 2, 0.0, 0.1))
    late = advanced(pose, Inertial(0.0, 0.0, 0.0), 0.2, 100.0)
    assert late.x == pytest.approx(0.1)  # half a second at most


def test_ground_scanned_before_a_reckoned_motion_comes_nearer() -> None:
    still = Inertial(0.0, 0.0, 0.0)
    robot = reckoned((0.0, Belts(0.2)), (0.0, still), (0.0, Joints(0.0, 0.0)), (0.0, ahead()))
    before = robot.estimate(0.0)[0].seen
    for k in range(1, 101):
        robot.update(Measured("inertial", 0.04 * k, still))
    after, angles = robot.estimate(4.0)
    assert before is not None
    assert after.seen is not None
    # 0.8 m later, what was seen from 0.45 to 1.25 m is from -0.35 to 0.45 m.
    assert after.seen.tolist() == [False] * 5 + [True] * 6 + [False] * 4
    assert angles.pitch == 0.0


def test_a_scan_corrects_the_height_that_slipping_belts_feign() -> None:
    climbing, level = Inertial(0.0, 0.5, 0.0), Inertial(0.0, 0.0, 0.0)
    robot = reckoned((0.0, Belts(0.2)), (0.0, level), (0.0, ahead()), (0.0, ahead()))
    robot.estimate(0.0)
    robot.update(Measured("inertial", 0.1, climbing))
    robot.update(Measured("inertial", 0.1, level))
    risen = robot.estimate(0.1)[0].heights[12]
    assert risen == pytest.approx(-0.1 - 0.02 * math.sin(0.5), abs=1e-3)
    robot.update(Measured("lidar", 0.1, ahead()))  # the ground is as far below as before
    assert robot.estimate(0.1)[0].heights[12] == pytest.approx(-0.1, abs=1e-3)


def turning(robot: LidarEstimator, scan: Scan | None, at: float) -> LidarEstimator:
    """Tip the robot up from 1 s on, with a scan of 1 s that arrives at another time."""
    for step in range(11):
        time = 1.0 + step / 100
        robot.update(Measured("attitude", time, Inertial(0.0, step / 20, 0.0)))
        if scan is not None and time >= at - 1e-9:
            robot.update(Measured("cloud", 1.0, scan))
            scan = None
    return robot


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_a_scan_that_comes_late_lies_where_it_was_measured(speed: float) -> None:
    """A cloud arrives after newer attitudes, by which the robot has already tipped up."""
    found = []
    for at in (1.0, 1.1):
        robot = told(estimator(), Joints(0.0, 0.0), Belts(speed))
        turning(robot, ahead(), at)
        found.append((robot.estimate(1.1)[0], robot.pose))
    (timely, pose), (late, other) = found
    assert astuple(other) == pytest.approx(astuple(pose), abs=1e-6)
    assert late.heights == pytest.approx(timely.heights, abs=1e-6)
    assert timely.seen is not None
    assert late.seen is not None
    assert late.seen.tolist() == timely.seen.tolist()
    assert timely.seen.any()
