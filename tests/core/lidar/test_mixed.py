"""Mixed returns are dropped, points of steep surfaces and of edges are not."""

import numpy as np
import pytest

from flipperctl.core.lidar.messages import Scan
from flipperctl.core.lidar.scans import without_mixed

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


def test_few_points_are_kept() -> None:
    scan = Scan(np.zeros((3, 3)))
    assert without_mixed(scan) is scan
