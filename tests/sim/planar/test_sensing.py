"""Sensing against heights worked by hand."""

import numpy as np
import pytest

from flipperctl.api import Profile
from flipperctl.sim.planar import PlanarSensor, TerrainSensor

FLAT = Profile([(0.0, 0.0), (0.0, 0.0)])
STEP = Profile([(0.0, 0.0), (0.0, 0.2)])
CENTRE = np.array([0.05, 0.3])  # [m]; the 0.05 keeps every point off the bins' edges


def sensor(profile: Profile, **settings: float) -> TerrainSensor:
    """Return a sensor with three bins of 1 m and a point every 0.1 m by default."""
    chosen = {"bins": 3, "bin_width": 1.0, "density": 10.0, **settings}
    return TerrainSensor(profile, PlanarSensor(**chosen), margin=3.0)


def look(of: TerrainSensor, position: np.ndarray = CENTRE, seed: int = 0) -> np.ndarray:
    return of.points(position, np.random.default_rng(seed))


def test_flat_ground_lies_below_the_chassis_centre_in_frame_l() -> None:
    heights = sensor(FLAT).heights(look(sensor(FLAT)))
    assert heights == pytest.approx([-0.3, -0.3, -0.3])


def test_a_step_is_averaged_with_the_points_of_its_face() -> None:
    of = sensor(STEP)
    # Middle bin, world x in [-0.45, 0.55): -0.4 … 0.0 are five points at 0 m; the face adds one
    # at 0.1 m and the corner at 0.2 m; 0.1 … 0.5 are five more at 0.2 m.
    # (0.1 + 0.2 + 5 · 0.2) / 12 = 0.10833 m, seen from 0.3 m.
    assert of.heights(look(of)) == pytest.approx([-0.3, 0.10833 - 0.3, 0.2 - 0.3], abs=1e-5)


def test_frame_l_moves_with_the_robot_and_stays_level() -> None:
    of = sensor(STEP)
    ahead = look(of, CENTRE + np.array([1.0, 0.2]))
    # 1 m ahead and 0.2 m up on the step: the face is now in the rear bin.
    assert of.heights(ahead) == pytest.approx([0.10833 - 0.5, -0.3, -0.3], abs=1e-5)
    assert np.diff(ahead[:, 0]).min() >= 0


@pytest.mark.parametrize(("bins", "width"), [(3, 1.0), (15, 0.15), (7, 0.4)])
def test_points_and_heights_follow_the_number_and_width_of_bins(bins: int, width: float) -> None:
    of = sensor(FLAT, bins=bins, bin_width=width, density=100.0)
    points = look(of)
    reach = bins * width / 2
    assert of.heights(points).shape == (bins,)
    assert points[:, 0].min() == pytest.approx(-reach, abs=0.011)
    assert points[:, 0].max() == pytest.approx(reach, abs=0.011)
    assert len(points) == pytest.approx(200 * reach, abs=1)


def test_the_paper_s_bins_see_1_125_m_both_ways() -> None:
    settings = PlanarSensor()
    assert (settings.bins, settings.size) == (15, 18)
    assert settings.reach == pytest.approx(1.125)


def test_terrain_beyond_the_horizon_is_not_seen_yet() -> None:
    wall = Profile([(1.0, 0.0), (1.0, 1.0)])
    near, far = sensor(wall, horizon=0.6), sensor(wall)
    assert look(near)[:, 0].max() < 0.6
    assert (
        look(near)[:, 0].min() == look(far)[:, 0].min()
    )  # behind the robot, every point stays in view
    assert look(near)[:, 1].max() == pytest.approx(-0.3)
    assert look(far)[:, 1].max() == pytest.approx(0.7)
    assert near.heights(look(near)) == pytest.approx([-0.3, -0.3, -0.3])


def test_noise_is_normal_in_height_alone() -> None:
    clean, noisy = sensor(FLAT, density=1000.0), sensor(FLAT, density=1000.0, noise=0.02)
    error = look(noisy) - look(clean)
    assert len(error) == pytest.approx(3000, abs=1)
    assert not error[:, 0].any()
    # 3000 draws: the mean varies by 0.02 / √3000 = 0.0004, the deviation 0.02 / √6000 = 0.0003
    assert error[:, 1].mean() == pytest.approx(0.0, abs=0.0016)
    assert error[:, 1].std() == pytest.approx(0.02, abs=0.0012)


def test_dropout_removes_that_fraction_of_the_points() -> None:
    points = look(sensor(FLAT, density=1000.0, dropout=0.3))
    # 3000 · 0.7 = 2100 remain, ± √(3000 · 0.3 · 0.7) = 25
    assert len(points) == pytest.approx(2100, abs=100)
    assert np.isin(points[:, 0], look(sensor(FLAT, density=1000.0))[:, 0]).all()


def test_equal_generators_give_equal_points() -> None:
    of = sensor(STEP, noise=0.05, dropout=0.2)
    assert np.array_equal(look(of, seed=3), look(of, seed=3))
    assert not np.array_equal(look(of, seed=3)[:5], look(of, seed=4)[:5])


def test_sensing_does_not_change_the_terrain() -> None:
    of = sensor(STEP, noise=0.05)
    before = look(of)
    for seed in range(5):
        look(of, seed=seed)
    assert np.array_equal(before, look(of))
