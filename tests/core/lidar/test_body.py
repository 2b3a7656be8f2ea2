"""The robot's own shape against numbers worked by hand; hinges at ±0.28 m, flippers to 0.716 m."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.body import Body

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)


def test_points_of_flippers_and_chassis_are_the_robots_own() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.7, 0.3, 0.0], [0.7, 0.0, 0.0], [0.7, 0.3, 0.3]])
    assert BODY.contains(points, 0.0, 0.0, 0.0).tolist() == [True, True, False, False]
    up = np.array([[0.28 + 0.4 * math.cos(1.0), -0.3, 0.4 * math.sin(1.0)]])
    assert BODY.contains(up, 1.0, 0.0, 0.0).all()
    assert not BODY.contains(up, 0.0, 1.0, 0.0).any()


def test_the_margin_makes_the_robot_larger() -> None:
    above = np.array([[0.0, 0.0, 0.13]])
    assert not BODY.contains(above, 0.0, 0.0, 0.02).any()
    assert BODY.contains(above, 0.0, 0.0, 0.04).all()


def test_rays_end_on_the_chassis_and_on_raised_flippers() -> None:
    origin = np.array([0.25, 0.0, 0.4])
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    assert BODY.distances(origin, down, 0.0, 0.0) == pytest.approx([0.3, math.inf])
    aside = np.array([[0.5, 0.3, -0.4]])
    length = float(np.linalg.norm(aside))
    # The ray sinks to the top of the level flipper, 0.1 m above the centre, at 0.75 of its way.
    level = BODY.distances(origin, aside / length, 0.0, 0.0)
    assert level == pytest.approx([0.75 * length])
    assert BODY.distances(origin, aside / length, 0.5, 0.0)[0] < level[0]


def test_circles_follow_pitch_and_flippers() -> None:
    circles = BODY.circles(0.0, math.pi / 2, -math.pi / 2)
    assert circles.max(axis=0) == pytest.approx([0.28, 0.336])
    assert circles.min(axis=0) == pytest.approx([-0.28, -0.336])
    nose_up = BODY.circles(math.pi / 2, 0.0, 0.0)
    assert nose_up.max(axis=0) == pytest.approx([0.0, 0.616], abs=1e-12)


def test_points_far_from_the_robot_are_not_its_own_and_do_not_hide_those_that_are() -> None:
    points = np.array([[9.0, 0.0, 0.0], [0.7, 0.3, 0.0], [0.0, 0.0, -5.0]])
    assert BODY.contains(points, 0.0, 0.0, 0.0).tolist() == [False, True, False]
