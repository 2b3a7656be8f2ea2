"""Scan matching: corrections where the points tell the motion, none where they do not."""

import math

import numpy as np
import pytest

from flipperctl.core.lidar.matching import ScanMatcher, _turned, determined

AHEAD = np.array([1.0, 0.0, 0.0])


@pytest.fixture
def matcher() -> ScanMatcher:
    pytest.importorskip("small_gicp")
    return ScanMatcher()


def test_a_direction_without_information_is_not_corrected() -> None:
    correction = np.array([0.1, 0.2, 0.3])
    ground = np.diag([0.0, 1.0, 9.0])  # shares 0, 0.1, 0.9
    assert determined(ground) @ correction == pytest.approx([0.0, 0.2, 0.3])
    half = np.diag([0.015, 0.485, 0.5])  # in the middle of the gate
    assert determined(half) @ correction == pytest.approx([0.05, 0.2, 0.3])


def corner(shift: float, turn: float = 0.0) -> np.ndarray:
    """Return points (P, 3) of level ground and of two walls, seen from ``shift`` further on."""
    rng = np.random.default_rng(2)
    ground = rng.uniform([-2, -2, 0], [2, 2, 0], (3000, 3))
    ahead = rng.uniform([2, -2, 0], [2, 2, 1], (1500, 3))
    beside = rng.uniform([-2, 2, 0], [2, 2, 1], (1500, 3))
    cos, sin = math.cos(turn), math.sin(turn)
    points = np.concatenate([ground, ahead, beside]) - [shift, 0.0, 0.0]
    turned = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(points @ turned.T)


def test_a_scan_of_walls_corrects_a_wrong_guess(matcher: ScanMatcher) -> None:
    start, wrong = np.zeros(3), np.array([0.15, 0.0, 0.0])
    assert matcher.corrected(corner(0.0), start, AHEAD)[0] == pytest.approx(start)
    saved = matcher.save()
    found, turn = matcher.corrected(corner(0.1), wrong, AHEAD)
    assert found == pytest.approx([0.1, 0.0, 0.0], abs=0.005)
    assert turn == pytest.approx(0.0, abs=1e-4)
    for _ in range(2):  # another keyframe, and a scan that is matched to it, too
        matcher.corrected(corner(0.5), np.array([0.5, 0.0, 0.0]), AHEAD)
    matcher.load(saved)
    assert np.array_equal(matcher.corrected(corner(0.1), wrong, AHEAD)[0], found)


def test_scans_of_walls_correct_a_heading_slowly_since_a_gyro_errs_slowly(
    matcher: ScanMatcher,
) -> None:
    matcher.corrected(corner(0.0), np.zeros(3), AHEAD)
    turned = corner(0.0, turn=0.02)  # as levelled with a heading that is 0.02 too small
    found, turn = matcher.corrected(turned, np.zeros(3), AHEAD)
    assert 5e-5 < turn < 0.02
    assert found == pytest.approx(np.zeros(3), abs=0.01)
    assert _turned(turned, 0.02) == pytest.approx(corner(0.0))


def test_level_ground_alone_leaves_the_guess_along_it(matcher: ScanMatcher) -> None:
    ground = corner(0.0)[:3000]
    matcher.corrected(ground, np.zeros(3), AHEAD)
    found, _ = matcher.corrected(ground, np.array([0.05, 0.0, 0.02]), AHEAD)
    assert found == pytest.approx([0.05, 0.0, 0.0], abs=0.003)


def test_keyframes_are_added_after_some_motion_and_the_oldest_are_forgotten(
    matcher: ScanMatcher,
) -> None:
    ground = corner(0.0)[:3000]
    counts = []
    for step in range(30):
        matcher.corrected(ground, np.array([0.1 * step, 0.0, 0.0]), AHEAD)
        counts.append(len(matcher.save()[0]))
    assert counts[:4] == [1, 1, 1, 2]  # after 0.3 m
    assert max(counts) == counts[-1] <= 12


def test_a_robot_that_was_lifted_has_not_moved_along_a_slope(matcher: ScanMatcher) -> None:
    rng = np.random.default_rng(3)
    ground = rng.uniform([-2, -2, 0], [2, 2, 0], (3000, 3))
    ground[:, 2] = 0.1 * ground[:, 0]  # alike wherever it is seen from along the slope
    matcher.corrected(ground, np.zeros(3), AHEAD)
    lifted = ground - [0.0, 0.0, 0.02]
    found, _ = matcher.corrected(lifted, np.array([0.02, 0.0, 0.002]), AHEAD)
    assert found[2] == pytest.approx(0.022, abs=0.003)
    assert found[0] == pytest.approx(0.02, abs=0.012)
