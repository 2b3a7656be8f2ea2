"""Scans before they enter the map: motion is corrected, mixed returns are dropped."""

import math
from dataclasses import astuple

import numpy as np
import pytest

from flipperctl.core.lidar.messages import Pose, Scan
from flipperctl.core.lidar.scans import Trail, without_mixed

START = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_points_measured_earlier_are_moved_by_the_motion_since() -> None:
    trail = Trail(START)
    trail.record(5.0, START)
    trail.record(5.1, end := Pose(0.02, 0.0, 0.01, 0.0, 0.2, 0.0))
    ahead = np.array([[1.0, 0.0, 0.0]] * 3)
    found = trail.levelled(ahead, np.array([0.1, 0.05, 0.0]), 5.1, end)
    half = [math.cos(0.1) - 0.01, 0.0, math.sin(0.1) - 0.005]  # half the way at half the pitch
    assert found == pytest.approx(
        np.array([[0.98, 0.0, -0.01], half, [math.cos(0.2), 0.0, math.sin(0.2)]])
    )


def test_headings_are_interpolated_over_their_jump_at_pi() -> None:
    trail = Trail(START)
    trail.record(1.0, Pose(0.0, 0.0, 0.0, 0.0, 0.0, math.pi - 0.1))
    trail.record(1.1, end := Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.1 - math.pi))
    found = trail.levelled(np.array([[1.0, 0.0, 0.0]]), np.array([0.05]), 1.1, end)
    assert found == pytest.approx(np.array([[-1.0, 0.0, 0.0]]))


def test_a_clock_that_jumps_back_and_absurd_ages_give_finite_points() -> None:
    trail = Trail(START)
    for time in (1e9, 1e9 + 0.01, 3.0):
        trail.record(time, Pose(time, 0.0, 0.0, 0.0, 0.0, 0.0))
    found = trail.levelled(np.zeros((3, 3)), np.array([-1.0, 0.1, 1e12]), 3.0, START)
    assert np.isfinite(found).all()


def test_points_in_any_order_of_their_ages_are_moved_alike() -> None:
    trail = Trail(START)
    trail.record(5.0, START)
    trail.record(5.1, end := Pose(0.02, 0.01, 0.01, 0.05, 0.2, 0.3))
    rng = np.random.default_rng(1)
    points, ages = rng.standard_normal((60, 3)), np.repeat([0.1, 0.06, 0.0], 20)
    order = rng.permutation(60)
    found = trail.levelled(points, ages, 5.1, end)
    assert trail.levelled(points[order], ages[order], 5.1, end) == pytest.approx(found[order])
    assert trail.levelled(points[:0], ages[:0], 5.1, end).shape == (0, 3)


def test_a_correction_of_an_earlier_pose_moves_the_later_ones_with_it() -> None:
    trail = Trail(START)
    trail.record(1.0, START)
    trail.record(1.1, newest := Pose(0.2, 0.0, 0.1, 0.05, 0.3, 0.0))
    between = trail.pose_at(1.05, newest)
    assert astuple(between) == pytest.approx((0.1, 0.0, 0.05, 0.025, 0.15, 0.0))
    assert trail.pose_at(1.1, newest) is newest
    corrected = Pose(0.1, 0.02, 0.04, 0.025, 0.15, math.pi / 2)
    found = trail.correct(1.05, between, corrected)
    assert astuple(found) == pytest.approx((0.1, 0.12, 0.09, 0.05, 0.3, math.pi / 2))
    assert astuple(trail.pose_at(1.0, found)) == pytest.approx(
        astuple(corrected)
    )  # nothing older is kept


@pytest.mark.parametrize("begin", [0.0, 0.05, 1000.0])
def test_where_the_clock_begins_changes_nothing(begin: float) -> None:
    """The pose before the first that is recorded is none at a time of its own."""
    trail = Trail(START)
    trail.record(begin, pitched := Pose(0.0, 0.0, 0.0, 0.0, 0.3, 0.0))
    found = trail.levelled(np.array([[1.0, 0.0, 0.0]]), np.array([0.1]), begin, pitched)
    assert found == pytest.approx(np.array([[math.cos(0.3), 0.0, math.sin(0.3)]]))
    assert trail.pose_at(begin - 0.1, pitched) == pitched


# Mixed returns are dropped, points of steep surfaces and of edges are not

ANGLES = np.radians(np.arange(0, 60, 1.6))


def ring(distances: np.ndarray, elevation: float = -0.5) -> np.ndarray:
    """Points at these distances on a ring, (P, 3) [m]."""
    cos, sin = np.cos(elevation), np.sin(elevation)
    rays = np.column_stack([cos * np.cos(ANGLES), cos * np.sin(ANGLES), np.full(len(ANGLES), sin)])
    return rays * distances[:, None]


def edge() -> np.ndarray:
    return np.where(np.arange(len(ANGLES)) < 18, 1.0, 1.6)


def test_a_point_alone_between_two_surfaces_is_dropped() -> None:
    distances = edge()
    distances[17] = 1.3
    points, ages = ring(distances), np.arange(len(ANGLES)) * 0.001
    found = without_mixed(Scan(points, ages))
    assert np.array_equal(found.points, np.delete(points, 17, axis=0))
    assert np.array_equal(found.ages, np.delete(ages, 17))


@pytest.mark.parametrize(
    "distances",
    [
        edge(),
        1.0 / np.cos(ANGLES),  # a wall, up to 60° of incidence
        0.5 / np.cos(ANGLES + np.radians(20)),  # up to 80°
        np.full(len(ANGLES), 2.0) + 0.01 * np.random.default_rng(0).standard_normal(len(ANGLES)),
    ],
    ids=["edge", "wall", "grazing", "noise"],
)
def test_surfaces_and_edges_are_kept(distances: np.ndarray) -> None:
    scan = Scan(ring(distances))
    assert without_mixed(scan) is scan


def test_across_the_rings_as_well() -> None:
    """A floor, then a point above it, then a floor 0.5 m lower, along one azimuth."""
    elevations = np.radians(np.arange(-80, -20, 2.5))
    heights = np.where(np.arange(len(elevations)) < 12, 0.5, 1.0)
    heights[11] = 0.72
    distances = heights / np.sin(-elevations)
    points = distances[:, None] * np.column_stack(
        [np.cos(elevations), np.zeros(len(elevations)), np.sin(elevations)]
    )
    assert len(without_mixed(Scan(points)).points) == len(points) - 1
