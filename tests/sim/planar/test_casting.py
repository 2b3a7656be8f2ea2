"""Rays at the ground of the side plane, by hand."""

import math

import numpy as np
import pytest

from flipperctl.sim.planar.rays import distances

LINE = np.array([(-5.0, 0.0), (0.0, 0.0), (0.0, 0.3), (1.0, 0.3), (1.0, -0.2), (5.0, -0.2)])


@pytest.mark.parametrize(
    ("direction", "reach", "expected"),
    [
        ((0, -1), 5, 0.1),  # down to the level
        ((1, 0), 5, 1.0),  # the face ahead
        ((1, 0), 0.9, math.inf),
        ((-1, 0), 5, math.inf),
        ((0.6, 0.8), 5, math.inf),  # above the edge
        ((0.8, 0.1), 5, 1.25),  # of a ray in 3-D that leads aside, the part in the plane
        ((0, 1), 5, math.inf),
    ],
)
def test_a_ray_ends_at_the_first_ground(
    direction: tuple[float, float], reach: float, expected: float
) -> None:
    (found,) = distances(LINE, np.array([-1.0, 0.1]), np.array([direction]), reach)
    assert found == pytest.approx(expected)


def test_a_ray_passes_over_the_block_into_the_hollow_behind_it() -> None:
    toward = np.array([[2.0, -0.7]]) / math.hypot(2.0, 0.7)
    (found,) = distances(LINE, np.array([0.0, 0.5]), toward, 9.0)
    assert found == pytest.approx(math.hypot(2.0, 0.7) * 0.2 / 0.7)  # the block's top, 0.2 below
    over = np.array([[2.0, -0.2]]) / math.hypot(2.0, 0.2)
    (found,) = distances(LINE, np.array([0.0, 0.5]), over, 9.0)
    assert found == pytest.approx(math.inf)  # it would land at x = 7
