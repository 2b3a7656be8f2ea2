"""The sideways slope of the ground in the map."""

import numpy as np
import pytest

from flipperctl.core.lidar.ground import lateral_slope, straightened

CELL = 0.025


def ground(slope: float, seed: int = 0) -> np.ndarray:
    """Return points of rising ground that leans sideways, with noise."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1.0, 1.0, 4000), rng.uniform(-0.36, 0.36, 4000)
    return np.column_stack([x, y, 0.5 * x + slope * y + 0.01 * rng.standard_normal(4000)])


def test_a_sideways_slope_is_found_and_removed() -> None:
    points = ground(0.2)
    slope = lateral_slope(points, CELL)
    assert slope == pytest.approx(0.2, abs=0.01)
    assert straightened(points, slope)[:, 2] == pytest.approx(0.5 * points[:, 0], abs=0.06)
    assert lateral_slope(ground(0.0), CELL) == pytest.approx(0.0, abs=0.01)


def test_a_block_on_one_side_and_too_few_points_are_no_slope() -> None:
    points = ground(0.0)
    block = (points[:, 1] > 0.0) & (np.abs(points[:, 0]) < 0.3)
    points[block, 2] += 0.2
    assert lateral_slope(points, CELL) == pytest.approx(0.0, abs=0.02)
    assert lateral_slope(points[:20], CELL) == 0.0
    assert lateral_slope(np.zeros((0, 3)), CELL) == 0.0
    narrow = points[np.abs(points[:, 1]) < 0.05]
    assert lateral_slope(narrow, CELL) == 0.0
