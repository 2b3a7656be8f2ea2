"""The robot's own shape and its rotations against numbers worked by hand.

The hinges are at ±0.28 m, the flippers reach to 0.716 m.
"""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.body import attitude, mounting
from tests.core.lidar.level_ground import BODY

THIRD = math.pi / 6


def test_points_of_flippers_and_chassis_are_the_robots_own() -> None:
    near = [[0, 0, 0], [0.7, 0.3, 0], [0.7, 0, 0], [0.7, 0.3, 0.3]]
    points = np.array([*near, [9, 0, 0], [0, 0, -5]])
    found = BODY.contains(points, (0.0, 0.0), 0.0).tolist()
    assert found == [True, True, False, False, False, False]
    up = np.array([[0.28 + 0.4 * math.cos(1.0), -0.3, 0.4 * math.sin(1.0)]])
    assert BODY.contains(up, (1.0, 0.0), 0.0).all()
    assert not BODY.contains(up, (0.0, 1.0), 0.0).any()
    above = np.array([[0.0, 0.0, 0.13]])
    assert not BODY.contains(above, (0.0, 0.0), 0.02).any()
    assert BODY.contains(above, (0.0, 0.0), 0.04).all()


def test_rays_end_on_the_chassis_and_on_raised_flippers() -> None:
    origin = np.array([0.25, 0.0, 0.4])
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    assert BODY.distances_to_chassis(origin, down) == pytest.approx([0.3, math.inf])
    aside = np.array([[0.5, 0.3, -0.4]])
    length = float(np.linalg.norm(aside))
    # The ray sinks to the top of the level flipper, 0.1 m above the centre, at 0.75 of its way.
    level, raised = (
        BODY.distances_to_flippers(origin, aside / length, (front, 0.0)) for front in (0.0, 0.5)
    )
    assert level == pytest.approx([0.75 * length])
    assert raised[0] < level[0]


def test_circles_follow_pitch_and_flippers() -> None:
    circles = BODY.circles(0.0, (math.pi / 2, -math.pi / 2))
    assert circles.max(axis=0) == pytest.approx([0.28, 0.336])
    assert circles.min(axis=0) == pytest.approx([-0.28, -0.336])
    nose_up = BODY.circles(math.pi / 2, (0.0, 0.0))
    assert nose_up.max(axis=0) == pytest.approx([0.0, 0.616], abs=1e-12)


def test_the_nose_rises_with_the_pitch_the_left_side_with_the_roll_and_yaw_turns_left() -> None:
    turn = attitude(0.1, THIRD, 0.0)
    assert turn[:, 0] == pytest.approx([math.cos(THIRD), 0.0, 0.5])
    assert turn[2, 1] == pytest.approx(math.sin(0.1))
    assert turn @ turn.T == pytest.approx(np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert attitude(0.0, 0.0, math.pi / 2)[:, 0] == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("axis", "expected"),
    [(math.pi / 2, (0, 0, 1)), (0.0, (1, 0, 0)), (-math.pi / 4, (0.5**0.5, 0, -(0.5**0.5)))],
)
def test_the_mounting_turns_the_axis_of_the_rings(axis: float, expected: tuple[float, ...]) -> None:
    turn = mounting(axis)
    assert turn[:, 2] == pytest.approx(expected)
    assert np.linalg.det(turn) == pytest.approx(1.0)
