"""Mean heights against numbers worked by hand, and against a plain loop bit for bit."""

import numpy as np
import pytest

from flipperctl.core import observation
from flipperctl.core.observation import mean_heights
from flipperctl.sim.planar.rays import sum_heights


def looped(points: np.ndarray, bins: int, width: float) -> list[float]:
    """Equation 1, bin by bin; every bin has a point."""
    inside: list[list[float]] = [[] for _ in range(bins)]
    for x, z in points.tolist():
        inside[min(int((x + bins * width / 2) / width), bins - 1)].append(z)
    return [sum(heights) / len(heights) for heights in inside]


def test_heights_equal_a_plain_loop_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = np.column_stack([np.linspace(-1.125, 1.125, 113), rng.normal(0.0, 0.3, 113)])
        assert mean_heights(points, 15, 0.15).tolist() == looped(points, 15, 0.15)
        assert mean_heights(points, 15, 0.15, sum_heights).tolist() == looped(points, 15, 0.15)


def test_an_empty_bin_takes_its_height_from_its_neighbours() -> None:
    points = np.array([[-2.0, 0.1], [0.0, 0.3], [0.2, 0.5]])  # bins 0 and 2; 1, 3, 4 are empty
    # 0.1, half way between, (0.3 + 0.5) / 2, and the last one known from there on
    assert mean_heights(points, 5, 1.0) == pytest.approx([0.1, 0.25, 0.4, 0.4, 0.4])


def test_without_any_point_every_height_is_zero() -> None:
    assert mean_heights(np.empty((0, 2)), 3, 1.0).tolist() == [0.0, 0.0, 0.0]


def test_edges_lie_symmetrically_about_the_chassis_centre() -> None:
    assert observation.edges(4, 0.5).tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]


def test_points_on_the_chassis_of_a_robot_that_pitches() -> None:
    # 2 m along the chassis and 1 m above it, with the nose 90° up: 1 m behind and 2 m up
    level = observation.to_level(np.array([[2.0, 1.0]]), np.pi / 2)
    assert level == pytest.approx(np.array([[-1.0, 2.0]]))
