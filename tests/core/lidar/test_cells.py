"""The rolling map keeps the newest points of places near the robot."""

import numpy as np
import pytest

from flipperctl.core.lidar.cells import Cells, Grid

GRID = Grid(cell=0.1, lane=0.1, keep=2)


def point(x: float, z: float, y: float = 0.0) -> np.ndarray:
    return np.array([[x, y, z]])


def heights(cells: Cells, x: float) -> list[float]:
    found = cells.around(x, 0.0, 0.0, (-1.0, 1.0), 0.5)[:, 2]
    return sorted(round(float(z), 3) for z in found)


def test_a_cell_holds_its_newest_points() -> None:
    cells = Cells(GRID, 2.0, 1.0)
    cells.add(np.concatenate([point(0.01, z) for z in (1.0, 2.0, 3.0)]), 0.0, 0.0)
    assert heights(cells, 0.0) == [2.0, 3.0]
    cells.add(point(0.02, 4.0), 0.0, 0.0)
    assert heights(cells, 0.0) == [3.0, 4.0]


def test_the_window_moves_with_the_robot() -> None:
    cells = Cells(GRID, 2.0, 1.0)
    cells.add(point(0.0, 1.0), 0.0, 0.0)
    cells.add(point(4.15, 2.0), 4.0, 0.0)  # 41 cells farther: in the same place of the memory
    assert heights(cells, 4.0) == [2.0]
    assert heights(cells, 0.0) == []
    cells.add(point(9.0, 3.0), 4.0, 0.0)  # beyond the window
    assert heights(cells, 9.0) == []


def test_points_are_returned_along_the_heading() -> None:
    cells = Cells(GRID, 2.0, 1.0)
    cells.add(point(0.5, 1.0, y=0.5), 0.0, 0.0)
    found = cells.around(0.0, 0.0, np.pi / 4, (-1.0, 1.0), 0.1)
    assert found == pytest.approx(np.array([[0.5**0.5, 0.0, 1.0]]), abs=1e-6)
    assert not len(cells.around(0.0, 0.0, 0.0, (-1.0, 1.0), 0.1))  # beside the strip


def test_a_snapshot_is_left_alone_by_later_points() -> None:
    cells = Cells(GRID, 2.0, 1.0)
    cells.add(point(0.0, 1.0), 0.0, 0.0)
    saved = cells.save()
    for _ in range(2):
        cells.add(point(0.0, 5.0), 0.0, 0.0)
    cells.load(saved)
    assert heights(cells, 0.0) == [1.0]


def test_cells_with_few_points_beside_full_ones_are_left_out_on_request() -> None:
    cells = Cells(Grid(cell=0.1, lane=0.1, keep=32), 2.0, 1.0)
    for x, count in ((-0.15, 30), (-0.05, 30), (0.05, 30), (0.15, 30), (0.25, 2), (1.55, 2)):
        cells.add(np.repeat(point(x, 0.0), count, axis=0), 0.0, 0.0)
    found = cells.around(0.0, 0.0, 0.0, (-2.0, 2.0), 0.5, dense=True)
    assert len(found) == 122  # few points far from others are all that is known there
    assert not np.isclose(found[:, 0], 0.25).any()
    assert len(cells.around(0.0, 0.0, 0.0, (-2.0, 2.0), 0.5)) == 124


def test_a_strip_at_an_angle_finds_every_point_within_it() -> None:
    rng = np.random.default_rng(2)
    cells = Cells(Grid(keep=128), 2.0, 1.0)
    points = np.column_stack([rng.uniform(-1, 1, 500), rng.uniform(-0.9, 0.9, 500), np.zeros(500)])
    cells.add(points, 0.0, 0.0)
    for yaw in (0.0, 0.3, -1.0):
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, beside = (points[:, :2] @ [[cos, -sin], [sin, cos]]).T
        inside = (np.abs(along) < 0.8) & (np.abs(beside) <= 0.2)
        assert len(cells.around(0.0, 0.0, yaw, (-0.8, 0.8), 0.2)) == inside.sum()
