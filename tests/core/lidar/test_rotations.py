"""Rotations against axes worked by hand."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.body import attitude, mounting

THIRD = math.pi / 6


def test_the_nose_rises_with_the_pitch_and_the_left_side_with_the_roll() -> None:
    turn = attitude(0.1, THIRD, 0.0)
    assert turn[:, 0] == pytest.approx([math.cos(THIRD), 0.0, 0.5])
    assert turn[2, 1] == pytest.approx(math.sin(0.1))
    assert turn @ turn.T == pytest.approx(np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_the_heading_turns_to_the_left() -> None:
    assert attitude(0.0, 0.0, math.pi / 2)[:, 0] == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("axis", "expected"),
    [(math.pi / 2, (0, 0, 1)), (0.0, (1, 0, 0)), (-math.pi / 4, (0.5**0.5, 0, -(0.5**0.5)))],
)
def test_the_mounting_turns_the_axis_of_the_rings(
    axis: float, expected: tuple[float, float, float]
) -> None:
    turn = mounting(axis)
    assert turn[:, 2] == pytest.approx(expected)
    assert np.linalg.det(turn) == pytest.approx(1.0)
