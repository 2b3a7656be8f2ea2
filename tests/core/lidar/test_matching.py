"""Scan matching: corrections where the points tell the motion, none where they do not."""

import numpy as np
import pytest

from flipperctl.core.lidar.matching import ScanMatcher, gated


def test_a_direction_without_information_is_not_corrected() -> None:
    correction = np.array([0.1, 0.2, 0.3])
    ground = np.diag([0.0, 1.0, 9.0])  # shares 0, 0.1, 0.9
    assert gated(correction, ground) == pytest.approx([0.0, 0.2, 0.3])
    half = np.diag([0.075, 0.425, 0.5])  # in the middle of the gate
    assert gated(correction, half) == pytest.approx([0.05, 0.2, 0.3])


def corner(shift: float) -> np.ndarray:
    """Return points (P, 3) of level ground and of two walls, seen from ``shift`` further on."""
    rng = np.random.default_rng(2)
    ground = rng.uniform([-2, -2, 0], [2, 2, 0], (3000, 3))
    ahead = rng.uniform([2, -2, 0], [2, 2, 1], (1500, 3))
    beside = rng.uniform([-2, 2, 0], [2, 2, 1], (1500, 3))
    return np.concatenate([ground, ahead, beside]) - [shift, 0.0, 0.0]


def test_a_scan_of_walls_corrects_a_wrong_guess_at_every_fifth_scan() -> None:
    pytest.importorskip("small_gicp")
    matcher = ScanMatcher()
    start, wrong = np.zeros(3), np.array([0.15, 0.0, 0.0])
    assert matcher.corrected(corner(0.0), start) == pytest.approx(start)
    saved = matcher.save()
    for _ in range(4):
        assert matcher.corrected(corner(0.1), wrong) is wrong
    found = matcher.corrected(corner(0.1), wrong)
    assert found == pytest.approx([0.1, 0.0, 0.0], abs=0.005)
    matcher.load(saved)
    again = [matcher.corrected(corner(0.1), wrong) for _ in range(5)][-1]
    assert np.array_equal(again, found)


def test_level_ground_alone_leaves_the_guess_along_it() -> None:
    pytest.importorskip("small_gicp")
    matcher = ScanMatcher()
    ground = corner(0.0)[:3000]
    matcher.corrected(ground, np.zeros(3))
    wrong = np.array([0.05, 0.0, 0.02])
    found = [matcher.corrected(ground, wrong) for _ in range(5)][-1]
    assert found == pytest.approx([0.05, 0.0, 0.0], abs=0.003)


def test_few_points_are_not_matched() -> None:
    pytest.importorskip("small_gicp")
    matcher = ScanMatcher()
    guess = np.ones(3)
    for _ in range(6):
        assert matcher.corrected(np.zeros((5, 3)), guess) is guess
