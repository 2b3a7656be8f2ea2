"""The standard deviation of each bin's height, by hand."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.certainty import Accuracy, deviations

NONE = Accuracy(height=0.0, along=0.0, filled=0.0)


def ground(step: float = 0.0) -> np.ndarray:
    """Return points of 5 bins of 0.2 m; the middle of the second has a face of this height."""
    x = np.arange(-0.49, 0.5, 0.02)
    return np.column_stack([x, np.where(x > -0.2, step, 0.0)])


def judged(accuracy: Accuracy, step: float = 0.0, since: float = 0.0, **more: float) -> list[float]:
    points = ground(step)
    filled = points[:, 0] > 0.3
    found = deviations(points, filled, np.full(5, since), 0.2, accuracy, **more)
    return [float(value) for value in found]


def test_unseen_bins_have_no_bound_and_others_at_least_that_of_all_heights() -> None:
    assert judged(Accuracy(height=0.01, along=0.5)) == pytest.approx([0.01] * 4 + [math.inf])


def test_an_error_along_the_way_counts_where_the_ground_rises() -> None:
    found = judged(Accuracy(height=0.0, along=0.02), step=0.1)
    assert found[:4] == pytest.approx([0.0, 0.02 * 0.1 / 0.2, 0.0, 0.0])


def test_tilt_counts_with_the_distance_and_drift_with_the_way_since_the_ground_was_seen() -> None:
    tilted = judged(Accuracy(height=0.0, along=0.0, tilt=0.01))
    assert tilted[:4] == pytest.approx([0.004, 0.002, 0.0, 0.002])
    drift = Accuracy(height=0.0, along=0.0, drift=0.1, climb=0.5)
    assert judged(drift, since=2.0)[0] == pytest.approx(0.1)
    assert judged(drift, since=2.0, step=0.1)[1] == pytest.approx(math.hypot(0.1, 0.2 * 0.5))
    assert judged(drift, unknown=0.2)[0] == pytest.approx(0.1)


def test_filled_parts_of_a_bin_count_by_their_share() -> None:
    points = ground()
    filled = points[:, 0] > 0.2  # half of the fourth bin, all of the fifth
    found = deviations(points, filled, np.zeros(5), 0.2, Accuracy(0.0, 0.0, filled=0.5))
    assert found.tolist() == pytest.approx([0.0, 0.0, 0.0, 0.5 * 0.5 * 0.2, math.inf])


def test_without_points_nothing_is_known() -> None:
    found = deviations(np.zeros((0, 2)), np.zeros(0, np.bool_), np.zeros(3), 0.2, NONE)
    assert np.isinf(found).all()
