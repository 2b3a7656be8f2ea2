"""Mixed returns at edges and returns that grazing incidence loses."""

import math

import numpy as np
import pytest

from flipperctl.api import FloatArray
from flipperctl.sim.lidar.scanner import RINGS, RangeErrors, Returns, directions

AZIMUTHS = 200
RAYS = directions(AZIMUTHS)
NONE = {"noise": 0.0, "bias": 0.0, "resolution": 0.0, "dropout": 0.0}


def wall(distance: float) -> FloatArray:
    """Return the distances to a wall across the axis of the rings."""
    return distance / RAYS[:, 2]


def measured(true: FloatArray, **errors: float) -> tuple[FloatArray, np.ndarray]:
    returns = Returns(RangeErrors(**{**NONE, **errors}), AZIMUTHS)
    return returns.measured(true, np.random.default_rng(0))


def test_returns_are_lost_from_an_angle_of_incidence_on() -> None:
    incidence = np.arccos(RAYS[:, 2])
    _, returned = measured(wall(1.0), grazing=1.3, grazing_width=0.1)
    assert returned[incidence < 1.25].all()
    assert not returned[incidence > 1.35].any()
    ring = np.abs(incidence - math.radians(73.625)) < 1e-6  # at 1.285 rad, 35 % are lost
    assert returned[ring].mean() == pytest.approx(0.65, abs=0.12)


def test_without_grazing_and_mixing_every_return_is_true() -> None:
    found, returned = measured(wall(1.0), grazing=2.0)
    assert returned.all()
    assert np.array_equal(found, wall(1.0))


def edge(gap: float) -> tuple[FloatArray, np.ndarray]:
    """Return distances of a half of the azimuths 1 m away, of the rest further, and the border."""
    true = np.full((AZIMUTHS, RINGS), 1.0)
    true[AZIMUTHS // 2 :] += gap
    border = np.zeros((AZIMUTHS, RINGS), bool)
    border[[0, AZIMUTHS // 2 - 1, AZIMUTHS // 2, -1]] = True
    return true.ravel(), border.ravel()


def test_a_fraction_of_the_returns_at_an_edge_lies_between_the_surfaces() -> None:
    true, border = edge(0.5)
    found, _ = measured(true, mixed=0.4)
    changed = found != true
    assert not changed[~border].any()
    assert changed[border].mean() == pytest.approx(0.4, abs=0.1)
    mixed = found[changed]
    assert (mixed.min(), mixed.max()) == (pytest.approx(1.0, abs=0.1), pytest.approx(1.5, abs=0.1))
    assert ((mixed > 1.0) & (mixed < 1.5)).all()


def test_surfaces_far_from_each_other_and_the_sky_do_not_mix() -> None:
    for gap in (1.1, math.inf):
        true, _ = edge(gap)
        found, _ = measured(true, mixed=1.0, mixed_gap=1.0)
        assert np.array_equal(found, true)


def test_a_smooth_surface_has_no_edges() -> None:
    true = wall(1.0)
    found, _ = measured(true, mixed=1.0, mixed_gap=10.0)
    assert np.array_equal(found, true)
