"""The estimator from messages alone, as on a robot: what it sees, assumes, corrects and refuses."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from flipperctl.core.lidar.body import Mount
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import GroundSeen
from flipperctl.core.lidar.messages import (
    Belts,
    Inertial,
    Joints,
    PerceptionError,
    Pose,
    Scan,
    checked,
    thinned,
    without_near,
)
from flipperctl.core.lidar.outline import Accuracy
from flipperctl.core.lidar.scans import advanced
from tests.core.lidar.level_ground import (
    LEVEL,
    STILL,
    UP,
    ahead,
    estimator,
    ground_of,
    heights_of,
    started,
    told,
)

RIGHT = Inertial(0.0, 0.0, 0.0)


def test_level_ground_is_a_track_radius_below_the_robot_and_partly_seen() -> None:
    ground, angles = told(estimator(), LEVEL, Joints(0.1, 0.2), ahead()).estimate(0.0)
    assert ground.heights == pytest.approx(-0.1)
    assert (angles.front, angles.rear, angles.pitch) == (0.1, 0.2, 0.0)
    # Seen from 0.45 to 1.125 m: the bins from 0.375 m on, not those below and behind the robot.
    assert ground.seen.tolist() == [False] * 10 + [True] * 5
    full = Scan(np.repeat(ahead().points, 30, axis=0))  # which is thinned
    assert len(full.points) > 28_800
    assert heights_of(told(estimator(), LEVEL, STILL, full)) == pytest.approx(-0.1, abs=1e-4)


def test_a_pitched_robot_sees_the_same_level_ground() -> None:
    turn = 0.2
    cos, sin = math.cos(turn), math.sin(turn)
    place = np.array([0.25, 0.0, 0.4])
    x, y, z = (ahead().points + place).T  # in frame R of a level robot
    scan = Scan(np.column_stack([cos * x + sin * z, y, cos * z - sin * x]) - place)
    robot = started(Pose(0.0, 0.0, 0.1, 0.0, turn, 0.0), scan)
    seen = ground_of(robot).seen
    assert seen.sum() >= 4
    assert heights_of(robot)[:, seen] == pytest.approx(-0.1, abs=1e-3)


def test_the_map_remembers_ground_that_is_behind_and_a_snapshot_restores_it() -> None:
    robot = told(estimator(), LEVEL, STILL, ahead(0.2))  # a block, 0.2 m high
    first, saved = ground_of(robot), robot.save()
    ground = ground_of(told(robot, Pose(1.0, 0.0, 0.3, 0.0, 0.0, 0.0)))
    assert ground.seen[4:8].all()
    assert ground.heights[4:8] == pytest.approx(-0.1, abs=0.001)
    told(robot, ahead(), ahead()).estimate(0.0)
    robot.load(saved)
    assert np.array_equal(ground_of(robot).points, first.points)


def test_points_of_the_robot_itself_and_numbers_that_are_not_finite_are_dropped() -> None:
    clean = ground_of(told(estimator(), LEVEL, STILL, ahead()))
    own = [[0.3, 0.25, -0.35], [-0.25, 0.0, -0.35]]  # on a front flipper and on the chassis
    odd = [[math.nan, 0.0, 0.0], [math.inf, 0.0, 0.0], [0.01, 0.0, 0.0]]
    scan = Scan(np.concatenate([ahead().points, np.array(10 * own + odd)]))
    bad = Pose(math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
    robot = told(estimator(), LEVEL, STILL, bad, Joints(math.inf, 0.0), scan)
    assert np.array_equal(ground_of(robot).points, clean.points)


def test_an_estimate_needs_messages_that_are_not_too_old() -> None:
    with pytest.raises(PerceptionError, match="nothing was measured yet"):
        estimator().estimate(0.0)
    robot = told(estimator(), Belts(0.2), STILL, ahead())
    now, later = (ground_of(robot, time).deviation for time in (0.0, 2.0))
    assert (later[10:] > now[10:] + 0.05).all()  # it may have moved by 0.4 m
    with pytest.raises(PerceptionError, match=r"the newest message is 12 s old"):
        robot.estimate(12.0)
    with pytest.raises(PerceptionError, match="the time of an estimate is nan"):
        robot.estimate(math.nan)


def test_the_sectors_of_a_turn_share_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[int] = []
    add = GroundSeen.add
    monkeypatch.setattr(
        GroundSeen, "add", lambda self, p, *at: (used.append(len(p)), add(self, p, *at))
    )
    robot = told(estimator(), LEVEL, STILL)
    beyond = ahead().points + np.array([0.8, 0.0, 0.0])  # none of the robot's own
    scan = Scan(np.repeat(beyond, 15, axis=0))
    for time in (1.0, 1.1, 1.1125, 1.1125):
        told(robot, scan, time=time)
    assert used == [10_000, 10_000, 1250, 500]
    twin = estimator()
    twin.load(robot.save())
    told(twin, scan, time=1.125)
    assert used[-1] == 1250


def test_unseen_ground_is_not_where_the_robot_is() -> None:
    x, z = ground_of(started(Pose(0.0, 0.0, 0.05, 0.0, 0.0, 0.0))).points.T
    assert z[np.abs(x) < 0.3] == pytest.approx(-0.1, abs=0.004)
    assert z[np.abs(x) > 0.8] == pytest.approx(-0.05)


def test_any_messages_give_a_finite_estimate() -> None:
    rng = np.random.default_rng(5)
    robot = estimator()
    for _ in range(60):
        scale = 10.0 ** rng.integers(-3, 7)
        points = scale * rng.standard_normal((rng.integers(0, 50), 3))
        points[rng.random(points.shape) < 0.05] = math.nan
        pose = Pose(*(rng.standard_normal(6) * scale).tolist())
        ground = ground_of(told(robot, pose, Joints(*rng.uniform(-4, 4, 2)), Scan(points)))
        assert np.isfinite(ground.heights).all()
        assert np.isfinite(ground.points).all()
        assert (np.diff(ground.points[:, 0]) >= 0).all()


# Messages of broken drivers


def test_numbers_that_cannot_be_are_dropped_with_their_message_and_points_alone() -> None:
    for time, value in (
        (0.0, Joints(math.nan, 0.0)),
        (0.0, Belts(1e6)),
        (math.inf, Belts(0.1)),
        (0.0, "a message of another device"),
    ):
        assert checked(time, value) is None
    assert checked(1, Belts(np.float32(0.5))) is not None  # type: ignore[arg-type]
    points = np.array([[1.0, 2.0, 3.0], [math.nan, 0.0, 0.0], [0.0, 1e9, 0.0]])
    assert checked(0.0, Scan(points))[1].points.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (Scan(np.zeros((4, 2))), r"points have the shape \(4, 2\); \(P, 3\) is needed"),
        (Scan([[0.0, 0.0, 0.0]]), "points is of the type list; an array of numbers is needed"),  # type: ignore[arg-type]
        (Joints("1", 0.0), "front is of the type str; a number is needed"),  # type: ignore[arg-type]
    ],
)
def test_a_malformed_message_is_refused_with_the_reason(value: object, reason: str) -> None:
    with pytest.raises(PerceptionError, match=reason):
        checked(0.0, value)


def test_rays_without_return_take_no_part() -> None:
    points = np.column_stack([np.arange(1.0, 5.0), np.zeros(4), np.zeros(4)])
    both = np.concatenate([points, np.zeros((100, 3))])
    found = thinned(without_near(Scan(both, np.arange(104.0)), 0.1), 4)
    assert found.points.tolist() == points.tolist()
    assert found.ages.tolist() == [0.0, 1.0, 2.0, 3.0]
    scan = Scan(points)
    assert without_near(scan, 0.1) is scan


def test_what_stood_where_rays_pass_now_is_forgotten() -> None:
    def ring(begin: float, height: float, wide: int) -> Scan:
        turns = np.arange(-wide, wide + 1) / 180
        turns, ways = np.meshgrid(turns, np.arange(begin, begin + 0.3, 0.01))
        x, y = (ways * np.cos(turns)).ravel(), (ways * np.sin(turns)).ravel()
        return Scan(np.column_stack([x, y, np.full(len(x), height)]))

    robot = told(estimator(), LEVEL, STILL, ring(0.55, -0.1, 45))  # 0.4 m high
    assert heights_of(robot)[1, 12:14] == pytest.approx(0.3, abs=0.01)  # 0.675 to 0.975 m ahead
    told(robot, LEVEL, STILL, ring(1.0, -0.5, 75), time=1.0)
    assert heights_of(robot, 1.0)[1, 12:14] == pytest.approx(-0.1, abs=0.01)


EDGE, DROP = 0.35, 0.5


def seen_over_an_edge() -> np.ndarray:
    """Return points in frame R of ground that drops, as a LiDAR 0.5 m above it sees them."""
    found = []
    for down in np.arange(0.1, 1.5, 0.004):
        for side in np.arange(-0.6, 0.61, 0.05):
            ray = np.array([math.cos(down), side, -math.sin(down)])
            point = UP.position + ray * (0.5 / -ray[2])
            if point[0] > EDGE:
                point = UP.position + ray * ((0.5 + DROP) / -ray[2])
                if point[0] < EDGE:  # the edge hides it
                    continue
            found.append(point)
    return np.array(found)


@pytest.mark.parametrize("in_chassis", [False, True])
def test_clouds_in_the_frame_of_the_chassis_erase_no_ground(in_chassis: bool) -> None:
    """Their rays do not begin at its origin, below which they would pass the ground."""
    points, mount = seen_over_an_edge(), UP
    if in_chassis:
        mount = Mount(x=0.0, z=0.0, axis=math.pi / 2, near=0.1, margin=0.02)
    robot = told(estimator(mount), LEVEL, Joints(0.5, 0.5))
    robot.estimate(0.0)
    heights = heights_of(told(robot, *[Scan(points - mount.position)] * 3))[0]
    assert heights[8] == pytest.approx(-0.1, abs=0.01)  # 0.075 to 0.225 m ahead
    assert heights[-1] == pytest.approx(-0.1 - DROP, abs=0.02)


# Odometry


def test_odometry_moves_along_the_chassis_and_turns_with_the_yaw_rate() -> None:
    pose = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    up = advanced(pose, Inertial(0.0, math.pi / 6, 0.0), 0.2, 0.1)
    assert (up.x, up.y, up.z) == pytest.approx((0.02 * math.sqrt(0.75), 0.0, 0.01))
    assert up.pitch == math.pi / 6
    left = advanced(pose, Inertial(0.0, 0.0, math.pi), 0.2, 0.5)
    assert (left.yaw, left.x, left.y) == pytest.approx((math.pi / 2, 0.0, 0.1))
    assert advanced(pose, RIGHT, 0.2, 100.0).x == pytest.approx(0.1)  # half a second at most


def test_ground_scanned_before_a_reckoned_motion_comes_nearer() -> None:
    robot = told(estimator(), Belts(0.2), RIGHT, STILL, ahead())
    robot.estimate(0.0)
    for k in range(1, 101):
        told(robot, RIGHT, time=0.04 * k)
    after, angles = robot.estimate(4.0)
    # 0.8 m later, what was seen from 0.45 to 1.25 m is from -0.35 to 0.45 m.
    assert after.seen.tolist() == [False] * 5 + [True] * 6 + [False] * 4
    assert angles.pitch == 0.0


def test_a_scan_corrects_the_height_that_slipping_belts_feign() -> None:
    robot = told(estimator(), Belts(0.2), RIGHT, ahead(), ahead())
    robot.estimate(0.0)
    told(robot, Inertial(0.0, 0.5, 0.0), RIGHT, time=0.1)
    risen = ground_of(robot, 0.1).heights[12]
    assert risen == pytest.approx(-0.1 - 0.02 * math.sin(0.5), abs=1e-3)
    told(robot, ahead(), time=0.1)  # the ground is as far below as before
    assert ground_of(robot, 0.1).heights[12] == pytest.approx(-0.1, abs=1e-3)


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_a_scan_that_comes_late_lies_where_it_was_measured(speed: float) -> None:
    """A cloud arrives after newer attitudes, by which the robot has already tipped up."""
    found = []
    for arrives in (0, 10):
        robot = told(estimator(), STILL, Belts(speed))
        for step in range(11):
            told(robot, Inertial(0.0, step / 20, 0.0), time=1.0 + step / 100)
            if step == arrives:
                told(robot, ahead(), time=1.0)
        found.append((ground_of(robot, 1.1), robot.pose))
    (timely, pose), (late, other) = found
    assert astuple(other) == pytest.approx(astuple(pose), abs=1e-6)
    assert late.heights == pytest.approx(timely.heights, abs=1e-6)
    assert late.seen.tolist() == timely.seen.tolist()
    assert timely.seen.any()


# What is assumed at the start, and the constant errors that are estimated there


@pytest.mark.parametrize("error", [0.02, -0.02])
def test_ground_seen_too_high_or_low_is_moved_to_where_the_robot_starts(error: float) -> None:
    heights = heights_of(told(estimator(), LEVEL, STILL, ahead(error)))
    # Mostly: the robot takes it for an error of the distances, which counts less further ahead.
    assert heights[:, :12] == pytest.approx(-0.1, abs=0.003)
    assert heights[0, 12:] == pytest.approx(-0.1, abs=abs(error) / 2)
    true = ahead().points
    scan = Scan(true * (1 + error / np.linalg.norm(true, axis=1, keepdims=True)))
    heights = heights_of(told(estimator(), LEVEL, STILL, scan))
    assert heights == pytest.approx(-0.1, abs=5e-4)  # all too long or short


def test_a_pitch_that_errs_at_the_start_is_corrected_there_and_less_later() -> None:
    robot = estimator(accuracy=Accuracy(tilt=0.02))
    errs = Inertial(0.0, 0.01, 0.0)  # of a robot that is level in truth
    told(robot, errs, STILL, ahead())
    pitches = [told(robot, errs, STILL, time=t).estimate(t)[1].pitch for t in (0.01, 30.0)]
    assert pitches == pytest.approx([0.0, 0.01 * (1 - math.exp(-1))], abs=0.001)


@pytest.mark.parametrize("pitch", [0.35, 0.05, -0.05, -0.35])
def test_a_robot_that_starts_on_a_slope_assumes_the_slope_behind_it(pitch: float) -> None:
    robot = told(estimator(), Pose(0.0, 0.0, 0.3, 0.0, pitch, 0.0), STILL)
    heights, bins = heights_of(robot)[0], (np.arange(15) - 7) * 0.15
    behind = bins < 0.28 - 0.15  # the front hinge
    expected = math.tan(pitch) * bins - 0.1 / math.cos(pitch)
    assert heights[behind] == pytest.approx(expected[behind], abs=0.012)
    turned = told(robot, ahead(0.05))  # it takes no bias of the range from that
    assert turned._errors.distance == turned._errors.pitch == 0.0


def test_a_robot_that_may_stand_on_an_obstacle_assumes_no_ground() -> None:
    for level in (True, False):
        robot = told(estimator(level=level), Pose(0.0, 0.0, 0.3, 0.0, 0.4, 0.0), STILL)
        slope = abs(ground_of(robot).heights[0] + 0.55) < 0.01  # of the chassis
        assert bool(slope) is level


@pytest.mark.parametrize("yaw", [math.pi / 2, math.pi, -2.5])
def test_ground_is_assumed_behind_the_start_whichever_way_it_faces(yaw: float) -> None:
    """A tracking system's frame begins anywhere."""
    block = ahead(0.2).points
    hidden = (block[:, 0] > 0.45) & (block[:, 0] < 0.7)
    found = []
    for x, y, heading in ((0.0, 0.0, 0.0), (3.0, -2.0, yaw)):
        robot = told(estimator(), replace(LEVEL, x=x, y=y, yaw=heading), STILL)
        robot.estimate(0.0)
        found.append(heights_of(told(robot, Scan(block[~hidden]))))
    assert found[0][:, :7] == pytest.approx(-0.1)
    assert found[0][:, 12:] == pytest.approx(0.1, abs=0.01)  # of the block, also where it is hidden
    assert found[1] == pytest.approx(found[0], abs=0.02)


def test_what_stands_on_another_storey_or_on_flippers_is_level() -> None:
    turned_back = started(Pose(0.2, 1.0, 3.1, 0.0, 0.0, math.pi), ahead())
    assert ground_of(turned_back).heights == pytest.approx(-0.1, abs=0.01)
    lifted = told(estimator(), Pose(0.0, 0.0, 0.11, 0.0, 0.05, 0.0), Joints(-0.1, 0.0))
    heights = heights_of(lifted)
    assert heights[:, :7] == pytest.approx(heights[0, 0])


@pytest.mark.parametrize("rise", [0.1, -0.1])
def test_a_first_scan_of_ground_elsewhere_takes_level_ground_and_errors_back(rise: float) -> None:
    """As on a landing at whose edge the robot starts, or on rough ground."""
    told_of = LEVEL, STILL, ahead(rise)
    robot = told(estimator(), *told_of)
    assert robot._errors.distance == robot._errors.pitch == 0.0
    heights = heights_of(robot)
    assert heights[:, 11:] == pytest.approx(rise - 0.1, abs=0.005)
    assert heights == pytest.approx(heights_of(told(estimator(level=False), *told_of)))


def test_raised_flippers_in_the_first_scan_are_no_ground_elsewhere() -> None:
    x, z = np.meshgrid(np.linspace(0.3, 0.45, 200), [0.1, 0.12, 0.14])  # of the front flippers
    own = np.column_stack([x.ravel(), np.full(x.size, 0.3), z.ravel()]) - (0.25, 0.0, 0.4)
    scan = Scan(np.vstack([ahead().points, own]))
    means, highest = heights_of(told(estimator(), LEVEL, Joints(0.4, 0.0), scan))
    assert means == pytest.approx(-0.1, abs=0.005)
    assert highest == pytest.approx(-0.1, abs=0.011)


# The window of the map turns with the robot


@pytest.mark.parametrize("yaw", [0.3, 0.5, math.pi, -2.5])
def test_the_ground_ahead_is_the_same_whichever_way_the_robot_heads(yaw: float) -> None:
    points = ahead().points
    points[points[:, 0] > 0.5, 2] += 0.15  # a step, 0.75 m ahead of the centre
    found = []
    for x, y, heading in ((0.0, 0.0, 0.0), (3.0, -2.0, yaw)):
        robot = told(estimator(), replace(LEVEL, x=x, y=y, yaw=heading), STILL)
        robot.estimate(0.0)
        found.append(ground_of(told(robot, Scan(points))))
    straight, turned = found
    assert turned.seen.tolist() == straight.seen.tolist()
    assert turned.heights == pytest.approx(straight.heights, abs=0.03)
    assert straight.heights[13] == pytest.approx(0.05, abs=0.01)


def test_a_robot_that_turns_and_turns_back_remembers_what_it_saw() -> None:
    robot: LidarEstimator = started(ahead())
    for turn in (0.5, 0.1, -0.5, 0.0):
        ground = ground_of(told(robot, replace(LEVEL, yaw=turn)))
    assert ground.seen[11:].all()
    assert heights_of(robot)[:, 11:] == pytest.approx(-0.1, abs=0.02)
