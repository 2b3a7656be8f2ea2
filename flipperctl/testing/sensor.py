"""Checks of a sensor: shapes, finite numbers, and random numbers from ``rng`` only."""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray, Profile, RobotState, Sensor
from flipperctl.testing.check import require

GROUND = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0)])
STATE = RobotState(
    position=np.array([-0.5, 0.1]),
    pitch=0.1,
    front=0.2,
    rear=-0.2,
    velocity=np.zeros(2),
    pitch_rate=0.0,
    time=1.0,
)


def senses(sensor: Sensor) -> None:
    """Check for finite points in order of x, a finite height per bin and finite angles."""
    ground, angles = sensor.over(GROUND, 5.0).sense(STATE, np.random.default_rng(0))
    points, heights = ground.points, ground.heights
    require(points.ndim == 2 and points.shape[1] == 2, f"points have shape {points.shape}")
    require(bool((np.diff(points[:, 0]) >= 0).all()), "the points' x decreases")
    require(heights.shape == (sensor.bins,), f"heights have shape {heights.shape}")
    finite = np.isfinite(points).all() and np.isfinite(heights).all()
    require(bool(finite), "a point or a height is not finite")
    require(bool(np.isfinite(_angles(angles)).all()), f"an angle is not finite: {angles}")


def repeats(sensor: Sensor) -> None:
    """Check that equal generators give equal perceptions and no other randomness is used."""
    before = np.random.get_state(legacy=False)  # noqa: NPY002  # read only, to see whether it is used
    found = []
    for _ in range(2):
        ground, angles = sensor.over(GROUND, 5.0).sense(STATE, np.random.default_rng(1))
        found.append(np.concatenate([ground.points.ravel(), ground.heights, _angles(angles)]))
    require(bool(np.array_equal(found[0], found[1])), "equal generators give unequal perceptions")
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    require(str(before) == str(after), "draws from numpy's global generator; only rng is allowed")


def _angles(angles: object) -> FloatArray:
    return np.array([getattr(angles, name) for name in ("front", "rear", "pitch")])
