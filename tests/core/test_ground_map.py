"""The map of the perceived ground: exact points stay exact, noisy ones are aligned and averaged."""

import numpy as np
import pytest

from flipperctl.api import Profile
from flipperctl.core.ground_map import GroundMap

GROUND = Profile([(0, 0), (0, 0.2), (0.6, 0.2), (0.9, 0.4), (1.5, 0.4)])


def scan(x: float, z: float, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    points = GROUND.sample(0.02, 4.0) - (x, z)
    points = points[np.abs(points[:, 0]) < 1.125]
    points[:, 1] += np.random.default_rng(seed).normal(0.0, noise, len(points)) if noise else 0.0
    return points


def heights(line: np.ndarray, x: float, z: float, at: np.ndarray) -> np.ndarray:
    return np.interp(at, line[:, 0] + x, line[:, 1] + z)


def test_exact_points_are_the_ground_to_a_few_millimetres() -> None:
    ground = GroundMap(memory=10)
    ground.add(scan(0.3, 0.5), (0.0, 0.0))
    at = np.array([-0.5, -0.1, 0.1, 0.4, 0.75, 1.2])
    found = heights(ground.line(), 0.3, 0.5, at)
    assert found == pytest.approx([GROUND.height(x) for x in at], abs=0.005)
    assert ground.noise < 1e-6


def test_the_motion_between_scans_is_measured() -> None:
    ground = GroundMap(memory=10)
    ground.add(scan(0.0, 0.5), (0.0, 0.0))
    # The robot was expected to drive 0.12 m, but drove 0.05 m and rose by 0.03 m.
    assert ground.add(scan(0.05, 0.53), (0.12, 0.0)) == pytest.approx((0.05, 0.03), abs=0.006)


def test_a_few_points_displace_no_map() -> None:
    ground = GroundMap(memory=3)
    ground.add(scan(0.3, 0.5), (0.0, 0.0))
    before = ground.line()
    for _ in range(5):
        ground.add(np.array([[-0.5, 0.0], [-0.4, 0.0]]), (0.0, 0.0))
    assert np.array_equal(ground.line(), before)
    few = GroundMap(memory=3)  # where there is nothing better, they count, as many as memory says
    for step in range(5):
        few.add(np.array([[0.1 * step, 0.0], [0.1 * step + 0.05, 0.0]]), (0.0, 0.0))
    assert len(few._scans) == 3


def test_noise_is_measured_and_averaged_away() -> None:
    ground = GroundMap(memory=10)
    for step in range(8):
        ground.add(scan(0.05 * step, 0.5, noise=0.01, seed=step), (0.05, 0.0))
    assert ground.noise == pytest.approx(0.01, rel=0.3)
    at = np.linspace(-0.6, 1.3, 80)
    at = at[np.abs(at) > 0.04]  # apart from the face
    truth = np.array([GROUND.height(x) for x in at])
    error = heights(ground.line(), 0.35, 0.5, at) - truth
    single = GroundMap(memory=1)
    single.add(scan(0.35, 0.5, noise=0.01, seed=99), (0.0, 0.0))
    alone = heights(single.line(), 0.35, 0.5, at) - truth
    assert np.sqrt((error**2).mean()) < 0.008
    assert np.sqrt((error**2).mean()) < np.sqrt((alone**2).mean())


def test_without_points_the_guess_moves_the_map() -> None:
    ground = GroundMap(memory=10)
    assert len(ground.line()) == 0
    assert ground.add(np.empty((0, 2)), (0.1, 0.0)) == (0.1, 0.0)
    ground.add(scan(0.0, 0.5), (0.0, 0.0))
    before = ground.line()
    ground.add(np.empty((0, 2)), (0.1, 0.02))
    assert ground.line() == pytest.approx(before - (0.1, 0.02), abs=0.01)
