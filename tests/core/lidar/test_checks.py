"""Messages of broken drivers: what is dropped and what is refused."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.messages import Belts, Joints, PerceptionError, Scan, checked


def test_numbers_that_cannot_be_are_dropped_with_their_message() -> None:
    assert checked(0.0, Joints(math.nan, 0.0)) is None
    assert checked(0.0, Belts(1e6)) is None
    assert checked(math.inf, Belts(0.1)) is None
    assert checked(0.0, "a message of another device") is None
    assert checked(1, Belts(np.float32(0.5))) is not None  # type: ignore[arg-type]


def test_points_that_cannot_be_are_dropped_alone() -> None:
    points = np.array([[1.0, 2.0, 3.0], [math.nan, 0.0, 0.0], [0.0, 1e9, 0.0]])
    found = checked(0.0, Scan(points))
    assert found is not None
    assert isinstance(found.value, Scan)
    assert found.value.points.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (Scan(np.zeros((4, 2))), r"points have the shape \(4, 2\); \(P, 3\) is needed"),
        (Scan([[0.0, 0.0, 0.0]]), "points is of the type list; an array of numbers is needed"),  # type: ignore[arg-type]
        (Joints("1", 0.0), "front is of the type str; a number is needed"),  # type: ignore[arg-type]
    ],
)
def test_a_malformed_message_is_refused_with_the_reason(value: object, reason: str) -> None:
    with pytest.raises(PerceptionError, match=reason):
        checked(0.0, value)
