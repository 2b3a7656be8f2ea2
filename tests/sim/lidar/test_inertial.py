"""Inertial unit, accelerometer, belt encoders, and scans of a robot on a sideways slope."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile, Robot, RobotState, Start
from flipperctl.core.lidar.body import Mount, attitude, mounting
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.lidar.instruments import (
    Accelerometer,
    BeltEncoders,
    InertialUnit,
    RangeErrors,
    Scanner,
    Tracking,
    levelled,
    to_world,
)
from flipperctl.sim.mujoco import Mujoco
from tests.core.lidar.level_ground import BODY
from tests.sim.lidar.test_lidar import EXACT

RNG = np.random.default_rng(0)
SLOPE = 0.2


def state(speed: float, time: float, pitch: float = 0.0) -> RobotState:
    velocity = np.array([speed, 0.0])
    return RobotState(np.array([0.0, 0.1]), pitch, 0.0, 0.0, velocity, 0.0, time)


@pytest.fixture(scope="module")
def leaning() -> object:
    """Return the world of a robot that stands on a slope, left side up."""
    sim = Mujoco(lateral_slope=SLOPE, friction=2.0)
    robot = Robot(track_speed=1e-9)
    world = sim.place(Profile([(0.0, 0.0)]), robot, Start(0.0), np.random.default_rng(0))
    world.advance(30)
    return world


def test_the_inertial_unit_errs_by_its_settings_and_its_bias_stays() -> None:
    rng = np.random.default_rng(1)
    unit = InertialUnit(0.01, 0.001, 0.0, 0.02, rng)
    found = [unit.measure(state(0.0, 0.0, pitch=0.3), rng) for _ in range(30_000)]
    pitches = np.array([measured.pitch for measured in found]) - 0.3
    assert pitches.std() == pytest.approx(0.01, rel=0.5)
    assert np.diff(pitches).std() == pytest.approx(0.001 * math.sqrt(2), rel=0.2)
    assert {measured.yaw_rate for measured in found} == {0.02}


def test_an_accelerometer_measures_gravity_along_its_axes_and_the_change_of_speed() -> None:
    unit = Accelerometer(0.0, np.zeros(3), 9.81)
    rest = unit.measure(state(0.0, 0.0, pitch=0.3), RNG)
    found = rest.x, rest.y, rest.z
    assert found == pytest.approx((9.81 * math.sin(0.3), 0.0, 9.81 * math.cos(0.3)))
    saved = unit.save()
    faster = unit.measure(state(0.02, 0.01), RNG)
    assert (faster.x, faster.z) == pytest.approx((2.0, 9.81))
    unit.load(saved)
    assert unit.measure(state(0.02, 0.01), RNG) == faster
    # Its bias stays and its noise is white.
    unit, rng = Accelerometer(0.1, np.array([0.5, 0.0, 0.0]), 9.81), np.random.default_rng(1)
    found = np.array([unit.measure(state(0.0, 0.01 * k), rng).x for k in range(2000)])
    assert (found.mean(), found.std()) == (pytest.approx(0.5, abs=0.01), pytest.approx(0.1, 0.1))


def test_belts_that_steer_are_measured_with_one_relative_error(leaning: object) -> None:
    assert BeltEncoders(0.2, 0.1).measure(state(0.0, 0.0), RNG).speed == pytest.approx(0.22)
    turned = Mujoco(yaw=0.3, heading_gain=1.0)
    world = turned.place(Profile([(0.0, 0.0)]), Robot(), Start(0.0), np.random.default_rng(0))
    now = world.state()
    found = BeltEncoders(0.2, 0.0).measure(now, RNG)
    assert found.speed == pytest.approx(0.2)
    assert found.difference == pytest.approx(-2 * 0.2 * now.yaw)  # the left belts are the faster


def test_on_a_sideways_slope_gravity_leans_and_the_scan_rolls_with_the_robot(
    leaning: object,
) -> None:
    now = leaning.state()  # type: ignore[attr-defined]
    assert now.roll == pytest.approx(SLOPE, abs=0.01)
    force = Accelerometer(0.0, np.zeros(3), 9.81).measure(now, RNG)
    assert force.y == pytest.approx(9.81 * math.sin(SLOPE), rel=0.05)
    mount = Mount(x=0.25, z=0.4, axis=-math.pi / 2, near=0.1, margin=0.05)
    errors = RangeErrors(noise=0.0, bias=0.0, resolution=0.0, dropout=0.0)
    scan = Scanner(60, 30.0, errors, mount, BODY, leaning).measure(now, RNG)  # type: ignore[arg-type]
    assert scan is not None
    points = np.array([0.25, 0.0, 0.4]) + scan.points @ mounting(mount.axis).T  # in frame R
    ground = points[np.abs(points[:, 1]) > 0.4]
    # The robot lies flat on the slope, which is parallel to its chassis on both sides.
    assert ground[:, 2] == pytest.approx(-0.1, abs=0.005)
    # By the true pose, the same ground leans in the map.
    pose = Tracking(None).measure(now, RNG)
    level = ground @ attitude(pose.roll, pose.pitch, pose.yaw).T
    leans = np.polyfit(level[:, 1], level[:, 2], 1)[0]
    assert leans == pytest.approx(math.tan(SLOPE), abs=0.01)
    assert levelled(now) @ to_world(now) == pytest.approx(
        attitude(pose.roll, pose.pitch, pose.yaw), abs=1e-9
    )


def test_on_a_sideways_slope_the_unit_turns_with_the_level_heading() -> None:
    """A robot that pitches turns its heading then, about the vertical and not about world's z."""
    world = Mujoco(lateral_slope=0.3).place(
        Profile([(0.2, 0.0), (1.2, 0.6)]), Robot(), Start(-0.6), np.random.default_rng(0)
    )
    unit = InertialUnit(0.0, 0.0, 0.0, 0.0, np.random.default_rng(0))
    first, turned = Tracking(None).measure(world.state(), RNG), 0.0
    for _ in range(400):
        turned += 0.01 * unit.measure(world.state(), RNG).yaw_rate
        world.advance(1)
    last = Tracking(None).measure(world.state(), RNG)
    assert abs(last.yaw - first.yaw) > 0.05
    turned += 0.01 * unit.measure(world.state(), RNG).yaw_rate
    assert turned == pytest.approx(last.yaw - first.yaw, abs=1e-6)


def test_on_a_sideways_slope_the_map_is_the_true_ground() -> None:
    env = FlipperEnv("flat", sim={"name": "mujoco", "lateral_slope": SLOPE}, perception=EXACT)
    env.reset(seed=3)
    for _ in range(2):
        env.step(4)
    below = -0.1 / math.cos(SLOPE)  # from the chassis centre straight down
    assert env.perception.observation[: env.layout.bins] == pytest.approx(below, abs=0.004)
