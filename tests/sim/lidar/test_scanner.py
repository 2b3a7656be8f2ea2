"""A turn of the LiDAR that is cast in parts while the robot moves."""

import math
from dataclasses import astuple

import numpy as np
import pytest

from flipperctl.api import RobotState
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.estimator import LidarEstimator, Mount
from flipperctl.core.lidar.ground import MapSettings
from flipperctl.core.lidar.messages import Joints, Pose, Scan
from flipperctl.core.sensing import Measured
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.lidar.scanner import RangeErrors, Scanner

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)
MOUNT = Mount(x=0.25, z=0.4, axis=-math.pi / 4, near=0.1, margin=0.05)
NONE = RangeErrors(noise=0.0, bias=0.0, resolution=0.0, dropout=0.0)


class Plane:
    """A world whose ground is level at z = 0."""

    def cast_rays(self, origin: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        with np.errstate(divide="ignore"):
            distance = -origin[2] / directions[:, 2]
        return np.where((distance > 0) & (distance <= reach), distance, np.inf)


def moving(time: float) -> RobotState:
    """Return the state of a robot that drives and rears up at 1 rad/s above level ground."""
    position = np.array([0.2 * time, 0.3])
    return RobotState(position, time, 0.0, 0.0, np.array([0.2, 0.0]), 1.0, time)


def scanner(parts: int, errors: RangeErrors = NONE) -> Scanner:
    return Scanner(60, 30.0, errors, MOUNT, BODY, Plane(), parts)


def turns(one: Scanner, samples: range) -> list[tuple[float, Scan]]:
    """Return the scans of a robot that begins to move at the first sample, with their times."""
    rng, found = np.random.default_rng(0), []
    for sample in samples:
        state = moving(0.01 * sample)
        if (scan := one.measure(state, rng)) is not None:
            found.append((state.time, scan))
    return found


def test_a_turn_ends_every_tenth_of_a_second_and_its_points_carry_their_ages() -> None:
    found = turns(scanner(5), range(0, 32, 2))
    assert [time for time, _ in found] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert found[0][1].ages is None  # at the start the robot has stood still for a turn
    ages = found[1][1].ages
    assert ages is not None
    assert np.unique(ages.round(9)) == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
    assert (np.diff(ages) <= 0).all()  # in the order in which they were measured


def heights(parts: int, deskew: bool) -> np.ndarray:
    """Return the errors of the points in the map of a robot that rears up."""
    robot = LidarEstimator(BODY, MOUNT, MapSettings(bins=15, bin_width=0.15), deskew=deskew)
    one, rng = scanner(parts), np.random.default_rng(0)
    for sample in range(0, 21, 10 // parts):
        state = moving(0.01 * sample)
        x, z = state.position.tolist()
        robot.update(Measured("pose", state.time, Pose(x, 0.0, z, 0.0, state.pitch, 0.0)))
        robot.update(Measured("joints", state.time, Joints(0.0, 0.0)))
        if sample and (scan := one.measure(state, rng)) is not None:
            robot.update(Measured("lidar", state.time, scan))
    ground, _ = robot.estimate(0.2)
    assert ground.filled is not None
    return ground.points[~ground.filled, 1] + 0.3


def test_motion_within_a_turn_shifts_the_ground_unless_the_points_are_corrected() -> None:
    instant, corrected, left = heights(1, True), heights(10, True), heights(10, False)
    assert np.abs(instant).max() < 1e-6
    assert np.abs(corrected).max() < 2e-3
    assert np.abs(left).max() > 0.02  # it rears up by 0.1 rad in a turn


def test_a_snapshot_in_the_middle_of_a_turn_repeats_it_bit_for_bit() -> None:
    one = scanner(10, RangeErrors(0.01, 0.0, 0.005, 0.1, mixed=0.2, grazing=1.4))
    turns(one, range(14))
    saved = one.save()
    first, again = turns(one, range(14, 25)), (one.load(saved), turns(one, range(14, 25)))[1]
    assert len(first) == 1
    for (_, a), (_, b) in zip(first, again, strict=True):
        assert all(np.array_equal(p, q) for p, q in zip(astuple(a), astuple(b), strict=True))


def test_a_simulator_goes_back_to_the_middle_of_a_turn() -> None:
    sensing = {"name": "lidar", "pose": "belts", "azimuths": 30}
    robot = {"control_period": 0.25}
    env = FlipperEnv("step", sim="mujoco", perception=sensing, robot=robot)
    env.reset(seed=2)
    simulator = env.simulator()
    simulator.perceive()

    def ahead() -> list[np.ndarray]:
        found = []
        for _ in range(3):
            simulator.step(4)
            found.append(simulator.perceive().observation)
        return found

    simulator.step(4)
    simulator.perceive()
    saved = simulator.save()
    first = ahead()
    simulator.load(saved)
    assert all(np.array_equal(*pair) for pair in zip(first, ahead(), strict=True))
