"""The simulated LiDAR: its rays, its errors, and the ground that comes of it."""

import math
import sys

import numpy as np
import pytest

from flipperctl.api import ACTIONS, RobotState
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.estimator import Mount
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError
from flipperctl.sim.lidar import LidarSensor
from flipperctl.sim.lidar.instruments import InertialErrors, InertialUnit
from flipperctl.sim.lidar.scanner import RINGS, RangeErrors, Scanner, directions
from flipperctl.sim.planar import PlanarSensor

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)
HOLD = ACTIONS.index((0, 0))
EXACT = {
    "noise": 0.0,
    "range_bias": 0.0,
    "resolution": 0.0,
    "dropout": 0.0,
    "mixed": 0.0,
    "grazing": 2.0,
}


class Plane:
    """A world whose ground is level at z = 0."""

    def cast_rays(self, origin: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        with np.errstate(divide="ignore"):
            distance = -origin[2] / directions[:, 2]
        return np.where((distance > 0) & (distance <= reach), distance, np.inf)


def at(z: float, pitch: float = 0.0) -> RobotState:
    still = np.zeros(2)
    return RobotState(np.array([0.0, z]), pitch, 0.0, 0.0, still, 0.0, 0.0)


def scan(errors: RangeErrors, mount: Mount, azimuths: int = 45) -> np.ndarray:
    scanner = Scanner(azimuths, 30.0, errors, mount, BODY, Plane())
    return scanner.measure(at(0.1), np.random.default_rng(0)).points


DOWN = Mount(x=0.25, z=0.4, axis=-math.pi / 2, near=0.1, margin=0.02)
NONE = RangeErrors(noise=0.0, bias=0.0, resolution=0.0, dropout=0.0)


def test_the_rings_are_those_of_the_manual() -> None:
    rays = directions(8)
    assert rays.shape == (8 * RINGS, 3)
    elevations = np.degrees(np.arcsin(rays[:, 2]))
    assert (elevations.min(), elevations.max()) == pytest.approx((2.3125, 89.5))
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)


def test_a_lidar_that_looks_down_sees_level_ground_half_a_metre_below_and_itself() -> None:
    below = scan(NONE, DOWN)[:, 2]  # the axis of frame S points down
    assert (below.min(), below.max()) == pytest.approx((0.3, 0.5))  # top of the robot, ground
    assert np.isclose(below, 0.3).sum() > 100
    assert np.isclose(below, 0.5).sum() > 100


def test_bias_noise_and_resolution_change_distances_and_dropout_loses_returns() -> None:
    true = np.linalg.norm(scan(NONE, DOWN), axis=1)
    biased = np.linalg.norm(scan(RangeErrors(0.0, 0.02, 0.0, 0.0), DOWN), axis=1)
    assert biased - true == pytest.approx(0.02)
    noisy = np.linalg.norm(scan(RangeErrors(0.03, 0.0, 0.0, 0.0), DOWN), axis=1)
    assert (noisy - true).std() == pytest.approx(0.03, rel=0.1)
    coarse = np.linalg.norm(scan(RangeErrors(0.0, 0.0, 0.05, 0.0), DOWN), axis=1) / 0.05
    assert coarse == pytest.approx(np.round(coarse), abs=1e-9)
    kept = len(scan(RangeErrors(0.0, 0.0, 0.0, 0.5), DOWN)) / len(true)
    assert kept == pytest.approx(0.5, abs=0.05)


def test_nothing_returns_from_the_blind_zone() -> None:
    blind = Mount(x=0.25, z=0.4, axis=-math.pi / 2, near=0.45, margin=0.02)
    assert np.linalg.norm(scan(NONE, blind), axis=1).min() >= 0.45


@pytest.mark.parametrize("engine", ["planar", "mujoco"])
def test_without_errors_the_map_is_the_true_ground_once_it_was_seen(engine: str) -> None:
    env = FlipperEnv("step", sim=engine, perception={"name": "lidar", **EXACT})
    env.reset(seed=3)  # a step of 3 cm
    first = env.perception
    assert first.filled is not None
    assert first.filled[first.points[:, 0] < -0.4].all()  # behind the robot
    assert not first.filled[(first.points[:, 0] > 0.5) & (first.points[:, 0] < 0.9)].any()
    for _ in range(8):
        env.step(HOLD)
    true = PlanarSensor().over(env.profile, 10.0).sense(env.state, np.random.default_rng(0))[0]
    heights = env.perception.observation[: env.layout.bins]
    assert heights == pytest.approx(true.heights, abs=0.012)
    assert np.abs(heights - true.heights).mean() < 0.003
    assert env.perception.pitch == env.state.pitch


def test_equal_seeds_give_equal_scans_and_other_noise_other_ones() -> None:
    def seen(seed: int) -> np.ndarray:
        env = FlipperEnv("step", perception={"name": "lidar", "azimuths": 60})
        env.reset(seed=seed)
        return env.step(HOLD)[0]

    assert np.array_equal(seen(1), seen(1))
    assert not np.array_equal(seen(1), seen(2))


def test_the_exact_sensor_is_that_of_the_true_ground() -> None:
    found = LidarSensor(bins=11).exact()
    assert found == PlanarSensor(bins=11)


def test_the_inertial_unit_errs_by_its_settings_and_its_bias_stays() -> None:
    errors = InertialErrors(0.01, 0.001, 0.0, 0.02)
    rng = np.random.default_rng(1)
    unit = InertialUnit(errors, rng)
    found = [unit.measure(at(0.1, pitch=0.3), rng) for _ in range(60_000)]
    pitches = np.array([measured.pitch for measured in found]) - 0.3
    assert pitches.std() == pytest.approx(0.01, rel=0.5)
    assert np.diff(pitches).std() == pytest.approx(0.001 * math.sqrt(2), rel=0.2)
    assert {measured.yaw_rate for measured in found} == {0.02}


def test_odometry_by_belts_follows_a_robot_that_does_not_slip() -> None:
    sensing = {"name": "lidar", "pose": "belts", **EXACT, "belt_error": 0.0}
    env = FlipperEnv("step", sim="mujoco", perception=sensing)
    env.reset(seed=3)  # a step of 3 cm
    for _ in range(8):
        env.step(HOLD)
    true = PlanarSensor().over(env.profile, 10.0).sense(env.state, np.random.default_rng(0))[0]
    heights = env.perception.observation[: env.layout.bins]
    assert np.abs(heights - true.heights).mean() < 0.004
    assert env.perception.pitch != env.state.pitch  # the unit's error


def test_the_pose_is_chosen_by_word_and_as_yaml_reads_it() -> None:
    assert LidarSensor(pose=True).pose == "true"  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="belts"):
        LidarSensor(pose="guess")  # type: ignore[arg-type]


def test_without_its_extra_matching_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    env = FlipperEnv("flat", perception={"name": "lidar", "pose": "matched"})
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[lidar\]'"):
        env.reset(seed=0)
