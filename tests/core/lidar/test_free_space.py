"""Rays that pass show where there is no ground, and the map forgets what was there."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.cells import Cells, Grid
from flipperctl.core.lidar.ground import FreeSpace

ORIGIN = np.array([1.0, 2.0, 0.5])


def space(*points: list[float]) -> FreeSpace:
    return FreeSpace(ORIGIN, np.array(points), reach=3.0, margin=0.05)


@pytest.mark.parametrize("turn", [0.0, 2.0, -3.1])
def test_a_ceiling_is_the_height_of_the_lowest_ray_over_the_place(turn: float) -> None:
    ahead = np.array([math.cos(turn), math.sin(turn)])
    at = [[*(ORIGIN[:2] + d * ahead), 0.0] for d in (0.5, 1.0, 1.9, 2.5)]
    low, high = [*(ORIGIN[:2] + 2.0 * ahead), -0.5], [*(ORIGIN[:2] + 3.5 * ahead), 0.5]
    found = space(low, high).ceilings(np.array(at))
    # The first ray falls by 1 m in 2 m; behind its return only the level one passes.
    assert found == pytest.approx([0.25, 0.0, -0.45, 0.5])


def test_places_that_no_ray_passes_have_no_ceiling() -> None:
    found = space([2.0, 2.0, 0.0]).ceilings(
        np.array([[0.5, 2.0, 0.0], [1.96, 2.0, 0.0], [2.5, 2.0, 0.0]])
    )
    assert np.isinf(found).all()  # beside the ray, just before its return, behind it


def test_points_of_the_map_above_a_ray_are_forgotten() -> None:
    cells = Cells(Grid(cell=0.1, lane=0.1, keep=2), 3.0, 1.0)
    points = np.array([[1.55, 2.05, 0.2], [1.55, 2.05, 0.0], [2.55, 2.05, 0.2]])
    cells.add(points, 1.0, 2.0)
    cells.clear_above(space([2.1, 2.1, -0.5]).ceilings, 1.0, 2.0, 0.03)
    left = cells.around(1.0, 2.0, 0.0, (-2.0, 2.0), 0.5)
    assert left[:, 0] == pytest.approx([0.55, 1.55])
    cells.add(points[:1], 1.0, 2.0)  # the place can be seen again
    assert len(cells.around(1.0, 2.0, 0.0, (-2.0, 2.0), 0.5)) == 3
