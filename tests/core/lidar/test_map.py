"""The map's cells, the rays that clear them, slopes, clearances and certainty, by hand."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.cells import Cells
from flipperctl.core.lidar.ground import (
    FreeSpace,
    clearances,
    lateral_slope,
    straightened,
)
from flipperctl.core.lidar.outline import Accuracy, deviations


def cells(keep: int = 2) -> Cells:
    return Cells(0.1, 0.1, keep, ahead=2.0, beside=1.0)


def point(x: float, z: float, y: float = 0.0) -> np.ndarray:
    return np.array([[x, y, z]])


def heights(of: Cells, x: float) -> list[float]:
    found = of.around(x, 0.0, 0.0, (-1.0, 1.0), 0.5)[:, 2]
    return sorted(round(float(z), 3) for z in found)


def test_a_cell_holds_its_newest_points_and_a_snapshot_restores_them() -> None:
    of = cells()
    of.add(np.concatenate([point(0.01, z) for z in (1.0, 2.0, 3.0)]), 0.0, 0.0)
    assert heights(of, 0.0) == [2.0, 3.0]
    saved = of.save()
    of.add(point(0.02, 4.0), 0.0, 0.0)
    assert heights(of, 0.0) == [3.0, 4.0]
    of.load(saved)
    assert heights(of, 0.0) == [2.0, 3.0]


def test_the_window_moves_with_the_robot() -> None:
    of = cells()
    of.add(point(0.0, 1.0), 0.0, 0.0)
    of.add(point(4.15, 2.0), 4.0, 0.0)  # 41 cells farther: in the same place of the memory
    assert heights(of, 4.0) == [2.0]
    assert heights(of, 0.0) == []
    of.add(point(9.0, 3.0), 4.0, 0.0)  # beyond the window
    assert heights(of, 9.0) == []


def test_cells_with_few_points_beside_full_ones_are_left_out_on_request() -> None:
    of = cells(keep=32)
    for x, count in ((-0.15, 30), (-0.05, 30), (0.05, 30), (0.15, 30), (0.25, 2), (1.55, 2)):
        of.add(np.repeat(point(x, 0.0), count, axis=0), 0.0, 0.0)
    found = of.around(0.0, 0.0, 0.0, (-2.0, 2.0), 0.5, dense=True)
    assert len(found) == 122  # few points far from others are all that is known there
    assert not np.isclose(found[:, 0], 0.25).any()
    assert len(of.around(0.0, 0.0, 0.0, (-2.0, 2.0), 0.5)) == 124


def test_a_strip_at_an_angle_finds_every_point_within_it() -> None:
    rng = np.random.default_rng(2)
    of = Cells(0.025, 0.09, 128, ahead=2.0, beside=1.0)
    points = np.column_stack([rng.uniform(-1, 1, 500), rng.uniform(-0.9, 0.9, 500), np.zeros(500)])
    of.add(points, 0.0, 0.0)
    for yaw in (0.0, 0.3, -1.0):
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, beside = (points[:, :2] @ [[cos, -sin], [sin, cos]]).T
        inside = (np.abs(along) < 0.8) & (np.abs(beside) <= 0.2)
        assert len(of.around(0.0, 0.0, yaw, (-0.8, 0.8), 0.2)) == inside.sum()


def test_a_turned_window_holds_the_newest_points_and_when_they_were_seen() -> None:
    of, left = cells(), math.pi / 2
    of.face(0.0, 0.0, left)
    for at, height in enumerate((0.0, 0.1, 0.2)):
        of.add(np.array([[0.0, 1.55, height], [0.0, 0.55, height]]), 0.0, 0.0, float(at))
    expected = {(x, 0.0, z) for x in (1.55, 0.55) for z in (0.1, 0.2)}
    for _ in range(2):
        found = of.around(0.0, 0.0, left, (-2.0, 2.0), 0.5)
        assert {tuple(row) for row in (np.round(found, 6) + 0.0).tolist()} == expected
        along, way = of.seen_at(0.0, 0.0, left, (-2.0, 2.0), 0.5)
        assert sorted(along) == pytest.approx([0.55, 1.55], abs=1e-6)
        assert way.tolist() == [2.0, 2.0]
        before = of.save()
        of.face(0.0, 0.0, left + 0.4)  # an oblique window, and back
        of.face(0.0, 0.0, left)
    of.load(before)
    assert np.array_equal(of.around(0.0, 0.0, left, (-2.0, 2.0), 0.5), found)


# Rays that pass show where there is no ground

ORIGIN = np.array([1.0, 2.0, 0.5])


def space(*points: list[float]) -> FreeSpace:
    return FreeSpace(ORIGIN, np.array(points), reach=3.0, margin=0.05)


@pytest.mark.parametrize("turn", [0.0, 2.0, -3.1])
def test_a_ceiling_is_the_height_of_the_lowest_ray_over_the_place(turn: float) -> None:
    way = np.array([math.cos(turn), math.sin(turn)])
    at = [[*(ORIGIN[:2] + d * way), 0.0] for d in (0.5, 1.0, 1.9, 2.5)]
    low, high = [*(ORIGIN[:2] + 2.0 * way), -0.5], [*(ORIGIN[:2] + 3.5 * way), 0.5]
    # The first ray falls by 1 m in 2 m; behind its return only the level one passes.
    found = space(low, high).ceilings(np.array(at))
    assert found == pytest.approx([0.25, 0.0, -0.45, 0.5])
    beside = np.array([[0.5, 2.0, 0.0], [1.96, 2.0, 0.0], [2.5, 2.0, 0.0]])
    # beside the ray, just before its return, behind it
    assert np.isinf(space([2.0, 2.0, 0.0]).ceilings(beside)).all()


# Sideways slopes and clearances

CELL = 0.025


def leaning(slope: float) -> np.ndarray:
    """Return points of rising ground that leans sideways, with noise."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1.0, 1.0, 4000), rng.uniform(-0.36, 0.36, 4000)
    return np.column_stack([x, y, 0.5 * x + slope * y + 0.01 * rng.standard_normal(4000)])


def test_a_sideways_slope_is_found_and_removed() -> None:
    points = leaning(0.2)
    slope = lateral_slope(points, CELL)
    assert slope == pytest.approx(0.2, abs=0.01)
    assert straightened(points, slope)[:, 2] == pytest.approx(0.5 * points[:, 0], abs=0.06)
    points = leaning(0.0)
    assert lateral_slope(points, CELL) == pytest.approx(0.0, abs=0.01)
    block = (points[:, 1] > 0.0) & (np.abs(points[:, 0]) < 0.3)  # on one side
    points[block, 2] += 0.2
    assert lateral_slope(points, CELL) == pytest.approx(0.0, abs=0.02)
    for few in (points[:20], np.zeros((0, 3)), points[np.abs(points[:, 1]) < 0.05]):
        assert lateral_slope(few, CELL) == 0.0


def test_the_clearance_is_measured_below_the_tracks_alone() -> None:
    circles = np.array([[0.0, 0.0], [0.3, 0.0]])
    flat = np.array([[0.0, -0.12], [0.05, -0.12], [0.09, 0.3]])  # the last one on a face
    found = clearances(circles, 0.1, flat)
    assert found == pytest.approx([0.02, 0.12 - 0.1 * math.sqrt(0.75), math.inf])
    assert clearances(circles, 0.1, np.array([[0.15, 0.0]])) == pytest.approx([math.inf])
    assert not len(clearances(circles, 0.1, np.zeros((0, 2))))


# The standard deviation of each bin's height


def ground(step: float = 0.0) -> np.ndarray:
    """Return points of 5 bins of 0.2 m; the middle of the second has a face of this height."""
    x = np.arange(-0.49, 0.5, 0.02)
    return np.column_stack([x, np.where(x > -0.2, step, 0.0)])


def judged(accuracy: Accuracy, step: float = 0.0, since: float = 0.0, **more: float) -> list[float]:
    points = ground(step)
    filled = points[:, 0] > 0.3
    return deviations(points, filled, np.full(5, since), 0.2, accuracy, **more).tolist()


def test_unseen_bins_have_no_bound_and_others_at_least_that_of_all_heights() -> None:
    assert judged(Accuracy(height=0.01, along=0.5)) == pytest.approx([0.01] * 4 + [math.inf])
    none = Accuracy(height=0.0, along=0.0, filled=0.0)
    found = deviations(np.zeros((0, 2)), np.zeros(0, np.bool_), np.zeros(3), 0.2, none)
    assert np.isinf(found).all()


def test_errors_count_by_steepness_distance_way_and_filled_share() -> None:
    found = judged(Accuracy(height=0.0, along=0.02), step=0.1)
    assert found[:4] == pytest.approx([0.0, 0.02 * 0.1 / 0.2, 0.0, 0.0])
    tilted = judged(Accuracy(height=0.0, along=0.0, tilt=0.01))
    assert tilted[:4] == pytest.approx([0.004, 0.002, 0.0, 0.002])
    drift = Accuracy(height=0.0, along=0.0, drift=0.1, climb=0.5)
    assert judged(drift, since=2.0)[0] == pytest.approx(0.1)
    assert judged(drift, since=2.0, step=0.1)[1] == pytest.approx(math.hypot(0.1, 0.2 * 0.5))
    assert judged(drift, unknown=0.2)[0] == pytest.approx(0.1)
    points = ground()
    filled = points[:, 0] > 0.2  # half of the fourth bin, all of the fifth
    found = deviations(points, filled, np.zeros(5), 0.2, Accuracy(0.0, 0.0, filled=0.5))
    assert found.tolist() == pytest.approx([0.0, 0.0, 0.0, 0.5 * 0.5 * 0.2, math.inf])
