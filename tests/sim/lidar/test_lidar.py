"""The simulated LiDAR: rays, errors, turns in parts, and the ground that comes of it."""

import math
import sys
from dataclasses import astuple

import numpy as np
import pytest

from flipperctl.api import ACTIONS, FloatArray, RobotState
from flipperctl.core.lidar.body import Mount
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality, MapSettings
from flipperctl.core.lidar.messages import Joints, Pose, Scan
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.sim.lidar import LidarSensor
from flipperctl.sim.lidar.instruments import (
    RINGS,
    OwnHits,
    RangeErrors,
    Returns,
    Scanner,
    directions,
)
from flipperctl.sim.planar import PlanarSensor
from tests.core.lidar.level_ground import BODY, told

HOLD = ACTIONS.index((0, 0))
ZERO = {"noise": 0.0, "bias": 0.0, "resolution": 0.0, "dropout": 0.0}
NONE = RangeErrors(**ZERO)
EXACT = {
    **{"name": "lidar", "noise": 0.0, "range_bias": 0.0, "resolution": 0.0, "dropout": 0.0},
    **{"mixed": 0.0, "grazing": 2.0},
}
"""Perception whose distances do not err."""


class Plane:
    """A world whose ground is level at z = 0."""

    def cast_rays(self, origin: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        with np.errstate(divide="ignore"):
            distance = -origin[2] / directions[:, 2]
        return np.where((distance > 0) & (distance <= reach), distance, np.inf)


def down(near: float = 0.1, axis: float = -math.pi / 2) -> Mount:
    return Mount(x=0.25, z=0.4, axis=axis, near=near, margin=0.02)


def below(mount: Mount | None = None, **errors: float) -> FloatArray:
    """Return the points of a scan of level ground by a LiDAR that looks down, (P, 3)."""
    made = RangeErrors(**{**ZERO, **errors})
    scanner = Scanner(45, 30.0, made, mount or down(), BODY, Plane())
    state = RobotState(np.array([0.0, 0.1]), 0.0, 0.0, 0.0, np.zeros(2), 0.0, 0.0)
    return scanner.measure(state, np.random.default_rng(0)).points


def ranges(*mount: Mount, **errors: float) -> FloatArray:
    return np.linalg.norm(below(*mount, **errors), axis=1)


def test_the_rings_are_those_of_the_manual() -> None:
    rays = directions(8)
    assert rays.shape == (8 * RINGS, 3)
    elevations = np.degrees(np.arcsin(rays[:, 2]))
    assert (elevations.min(), elevations.max()) == pytest.approx((2.3125, 89.5))
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)


def test_bias_noise_and_resolution_change_distances_and_dropout_loses_returns() -> None:
    true = ranges()
    depth = below()[:, 2]  # of the top of the robot, and of the ground
    assert (depth.min(), depth.max()) == pytest.approx((0.3, 0.5))
    assert np.isclose(depth, 0.3).sum() > 100
    assert np.isclose(depth, 0.5).sum() > 100
    assert ranges(bias=0.02) - true == pytest.approx(0.02)
    assert (ranges(noise=0.03) - true).std() == pytest.approx(0.03, rel=0.1)
    coarse = ranges(resolution=0.05) / 0.05
    assert coarse == pytest.approx(np.round(coarse), abs=1e-9)
    assert len(ranges(dropout=0.5)) / len(true) == pytest.approx(0.5, abs=0.05)
    assert ranges(down(near=0.45)).min() >= 0.45  # nothing returns from the blind zone


@pytest.mark.parametrize("side", [0.0, 0.1])
def test_no_ray_that_can_hit_a_flipper_is_left_out_whatever_the_angles(side: float) -> None:
    rng = np.random.default_rng(0)
    origin = np.array([0.25, side, 0.4])
    rays = rng.standard_normal((2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    own, possible = OwnHits(BODY, origin, rays), BODY.may_hit_flippers(origin, rays)
    assert 0.1 < possible.mean() < 0.6  # or nothing is saved
    chassis = BODY.distances_to_chassis(origin, rays)
    for angle in np.linspace(-1.5, 1.5, 13):
        flippers = BODY.distances_to_flippers(origin, rays, (angle, -angle))
        assert not (np.isfinite(flippers) & ~possible).any()
        assert (own.distances((angle, -angle)) == np.minimum(chassis, flippers)).all()


# Mixed returns at edges and returns that grazing incidence loses

AZIMUTHS = 200
RAYS = directions(AZIMUTHS)
WALL = 1.0 / RAYS[:, 2]
"""Distances to a wall across the axis of the rings."""


def measured(true: FloatArray, **errors: float) -> tuple[FloatArray, np.ndarray]:
    returns = Returns(RangeErrors(**{**ZERO, **errors}), AZIMUTHS)
    return returns.measured(true, np.random.default_rng(0))


def test_returns_are_lost_from_an_angle_of_incidence_on() -> None:
    incidence = np.arccos(RAYS[:, 2])
    _, returned = measured(WALL, grazing=1.3, grazing_width=0.1)
    assert returned[incidence < 1.25].all()
    assert not returned[incidence > 1.35].any()
    ring = np.abs(incidence - math.radians(73.625)) < 1e-6  # at 1.285 rad, 35 % are lost
    assert returned[ring].mean() == pytest.approx(0.65, abs=0.12)
    found, returned = measured(WALL, grazing=2.0)
    assert returned.all()
    assert np.array_equal(found, WALL)


def edge(gap: float) -> tuple[FloatArray, np.ndarray]:
    """Return distances of a half of the azimuths 1 m away, of the rest further, and the border."""
    true = np.full((AZIMUTHS, RINGS), 1.0)
    true[AZIMUTHS // 2 :] += gap
    border = np.zeros((AZIMUTHS, RINGS), bool)
    border[[0, AZIMUTHS // 2 - 1, AZIMUTHS // 2, -1]] = True
    return true.ravel(), border.ravel()


def test_a_fraction_of_the_returns_at_an_edge_lies_between_the_surfaces() -> None:
    true, border = edge(0.5)
    found, _ = measured(true, mixed=0.4)
    changed = found != true
    assert not changed[~border].any()
    assert changed[border].mean() == pytest.approx(0.4, abs=0.1)
    mixed = found[changed]
    assert (mixed.min(), mixed.max()) == (pytest.approx(1.0, abs=0.1), pytest.approx(1.5, abs=0.1))
    assert ((mixed > 1.0) & (mixed < 1.5)).all()


@pytest.mark.parametrize(
    "true", [edge(1.1)[0], edge(math.inf)[0], WALL], ids=["far", "sky", "wall"]
)
def test_surfaces_far_from_each_other_and_smooth_ones_do_not_mix(true: FloatArray) -> None:
    found, _ = measured(true, mixed=1.0, mixed_gap=1.0)
    assert np.array_equal(found, true)


# A turn that is cast in parts while the robot moves


def moving(time: float) -> RobotState:
    """Return the state of a robot that drives and rears up at 1 rad/s above level ground."""
    position = np.array([0.2 * time, 0.3])
    return RobotState(position, time, 0.0, 0.0, np.array([0.2, 0.0]), 1.0, time)


def in_parts(parts: int, errors: RangeErrors = NONE) -> Scanner:
    return Scanner(60, 30.0, errors, down(axis=-math.pi / 4), BODY, Plane(), parts)


def turns(one: Scanner, samples: range) -> list[tuple[float, Scan]]:
    """Return the scans of a robot that begins to move at the first sample, with their times."""
    rng = np.random.default_rng(0)
    found = [(0.01 * sample, one.measure(moving(0.01 * sample), rng)) for sample in samples]
    return [(time, scan) for time, scan in found if scan is not None]


def test_a_turn_ends_every_tenth_of_a_second_and_its_points_carry_their_ages() -> None:
    found = turns(in_parts(5), range(0, 32, 2))
    assert [time for time, _ in found] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert found[0][1].ages is None  # at the start the robot has stood still for a turn
    ages = found[1][1].ages
    assert np.unique(ages.round(9)) == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
    assert (np.diff(ages) <= 0).all()  # in the order in which they were measured


def map_errors(parts: int, deskew: bool) -> np.ndarray:
    """Return the errors of the points in the map of a robot that rears up."""
    settings = MapSettings(15, 0.15, quality=MapQuality(deskew=deskew))
    robot = LidarEstimator(BODY, down(axis=-math.pi / 4), settings)
    one, rng = in_parts(parts), np.random.default_rng(0)
    for sample in range(0, 21, 10 // parts):
        state = moving(0.01 * sample)
        (x, z), time = state.position.tolist(), state.time
        told(robot, Pose(x, 0.0, z, 0.0, state.pitch, 0.0), Joints(0.0, 0.0), time=time)
        if sample and (scan := one.measure(state, rng)) is not None:
            told(robot, scan, time=time)
    ground, _ = robot.estimate(0.2)
    return ground.points[~ground.filled, 1] + 0.3


def test_motion_within_a_turn_shifts_the_ground_unless_the_points_are_corrected() -> None:
    assert np.abs(map_errors(1, True)).max() < 1e-6  # at one instant
    assert np.abs(map_errors(10, True)).max() < 2e-3
    assert np.abs(map_errors(10, False)).max() > 0.02  # it rears up by 0.1 rad in a turn


def test_a_snapshot_in_the_middle_of_a_turn_repeats_it_bit_for_bit() -> None:
    one = in_parts(10, RangeErrors(0.01, 0.0, 0.005, 0.1, mixed=0.2, grazing=1.4))
    turns(one, range(14))
    saved = one.save()
    ((_, first),) = turns(one, range(14, 25))
    one.load(saved)
    ((_, again),) = turns(one, range(14, 25))
    assert all(np.array_equal(p, q) for p, q in zip(astuple(first), astuple(again), strict=True))


def test_a_simulator_goes_back_to_the_middle_of_a_turn() -> None:
    sensing = {"name": "lidar", "pose": "belts", "azimuths": 30}
    env = FlipperEnv("step", sim="mujoco", perception=sensing, robot={"control_period": 0.25})
    env.reset(seed=2)
    simulator = env.simulator()
    simulator.perceive()

    def ahead() -> list[np.ndarray]:
        return [(simulator.step(4), simulator.perceive().observation)[1] for _ in range(3)]

    simulator.step(4)
    simulator.perceive()
    saved, first = simulator.save(), ahead()
    simulator.load(saved)
    assert all(np.array_equal(*pair) for pair in zip(first, ahead(), strict=True))


# The ground in episodes


@pytest.mark.parametrize(("engine", "pose"), [("planar", "true"), ("mujoco", "belts")])
def test_without_errors_the_map_is_the_true_ground_once_it_was_seen(engine: str, pose: str) -> None:
    """By odometry too, as the belts do not slip."""
    sensing = {**EXACT, "pose": pose, "belt_error": 0.0}
    env = FlipperEnv("step", sim=engine, perception=sensing)
    env.reset(seed=3)  # a step of 3 cm
    first = env.perception
    assert first.filled[first.points[:, 0] < -0.4].all()  # behind the robot
    assert not first.filled[(first.points[:, 0] > 0.5) & (first.points[:, 0] < 0.9)].any()
    for _ in range(8):
        env.step(HOLD)
    true = PlanarSensor().over(env.profile, 10.0).sense(env.state, np.random.default_rng(0))[0]
    off = np.abs(env.perception.observation[:-3] - true.heights)
    assert off.mean() < (0.003 if pose == "true" else 0.004)
    assert pose == "belts" or off.max() < 0.012
    assert (env.perception.pitch == env.state.pitch) is (pose == "true")  # or the unit errs


def test_settings_of_the_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    assert LidarSensor(bins=11).exact() == PlanarSensor(bins=11)
    assert LidarSensor(pose=True).pose == "true"  # type: ignore[arg-type]  # as YAML reads it
    with pytest.raises(ValueError, match="belts"):
        LidarSensor(pose="guess")  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    env = FlipperEnv("flat", perception={"name": "lidar", "pose": "matched"})
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[lidar\]'"):
        env.reset(seed=0)
