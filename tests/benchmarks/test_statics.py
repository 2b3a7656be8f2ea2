"""Where a robot can stand, and what no setting of the flippers can avoid, worked by hand."""

import math

import numpy as np
import pytest

from benchmarks.statics import standing, static_bound
from flipperctl.api import FloatArray, Robot

FLAT = np.array([[0.0, 0.0], [0.3, 0.0]])
RIGID = Robot(angle_limit=0.01, angle_step=0.01)
"""Its flippers stay in line with the chassis."""


def slope(degrees: float, length: float) -> FloatArray:
    """Return an incline up of this length [m], with level ground behind it."""
    angle = math.radians(degrees)
    return np.array([[0.0, 0.0], [length * math.cos(angle), length * math.sin(angle)]])


def bound(points: FloatArray, robot: Robot | None = None) -> float:
    robot = robot or Robot()
    return math.degrees(static_bound(points, robot, start=-1.0, finish=points[-1, 0] + 1.0))


def test_level_ground_demands_nothing_and_lets_the_flippers_lift_an_end() -> None:
    assert bound(FLAT) == 0.0
    found = standing(FLAT, Robot(), start=-0.1, finish=0.4)
    assert found.places == pytest.approx(np.arange(26) * 0.02 - 0.1)
    degrees = np.degrees(found.pitches)
    # The rear flippers at -60° lift the rear hinge: 0.56 sin a = 0.336 sin(60° - a), a = 21.8°.
    lowest = [degrees[possible].min() for possible in found.possible]
    assert lowest == pytest.approx([-21.8] * 26, abs=2.0)
    rigid = standing(FLAT, RIGID, start=-0.1, finish=0.4)
    assert np.abs(np.degrees(rigid.pitches)[rigid.possible.any(axis=0)]).max() <= 3.5


def test_without_flippers_a_slope_costs_twice_its_angle() -> None:
    # All tolerances together are 11°: twice 3° on the slope, 4° at the finish, 1° of the grid.
    assert 49.0 <= bound(slope(30, 3.0), RIGID) <= 60.0
    assert 29.0 <= bound(slope(20, 3.0), RIGID) <= 40.0


def test_flippers_carry_the_chassis_only_so_far() -> None:
    # 21.8° less than the slope, thus 8.2° on 30°. The finish allows 10.3° (0.1 m of 0.56 m).
    assert 4.0 <= bound(slope(30, 3.0)) <= 8.2
    assert bound(slope(20, 3.0)) == 0.0
    # On 40° it is 18.2° up, and then 7.9° down to the finish.
    assert 18.0 <= bound(slope(40, 3.0)) <= 26.1


def test_the_robot_stands_on_both_sides_of_its_centre_of_mass() -> None:
    edge = np.array([[0.0, 0.0], [0.0, -2.0]])  # a cliff
    found = standing(edge, Robot(), start=-1.0, finish=0.3)
    able = found.places[found.possible.any(axis=1)]
    assert np.isin(np.round(np.arange(-0.98, 0.0, 0.02), 2), np.round(able, 2)).all()
    # Past the edge the rear tips up, until the robot leans against the wall from below.
    assert not ((able > 0.13) & (able < 0.23)).any()


def test_the_bound_grows_with_a_start_that_is_not_level_and_takes_any_length() -> None:
    tilted = static_bound(FLAT, RIGID, start=-1.0, finish=1.3, pitch=math.radians(30))
    assert math.degrees(tilted) == pytest.approx(26.0, abs=2.5)
    long = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 0.2], [10.0, 0.2]])
    whole = standing(long, Robot(), start=-1.0, finish=11.0)
    part = standing(long, Robot(), start=8.0, finish=10.0)
    first = round(9.0 / 0.02)
    assert len(whole.places) == 601
    same = whole.possible[first : first + len(part.places)] == part.possible
    assert same.mean() > 0.999  # places differ in their last bits
