"""The outline of noisy points: faces stand upright, gaps are filled and marked."""

import numpy as np
import pytest

from flipperctl.core.lidar.outline import (
    Columns,
    columns,
    points_along,
    polyline,
    with_assumed,
    with_drops,
)

NOISE = 0.01


def sorted_columns(points: np.ndarray) -> Columns:
    return columns(points, 0.025, 4)


def step(height: float, at: float, spread: float = NOISE) -> np.ndarray:
    """Return noisy points of a step, (P, 3): 20 to a column of 2.5 cm, and 60 of its face."""
    rng = np.random.default_rng(4)
    x = np.arange(-0.5, 0.5, 0.025 / 20)
    ground = np.column_stack([x, np.where(x < at, 0.0, height)])
    face = np.column_stack([np.full(60, at), np.linspace(0.0, height, 60)])
    both = np.concatenate([ground, face])
    both += spread * rng.standard_normal(both.shape)
    return np.insert(both, 1, 0.0, axis=1)


@pytest.mark.parametrize("at", [0.0, 0.013, 0.12])
@pytest.mark.parametrize("height", [0.2, -0.2, 0.1])
def test_a_riser_becomes_one_vertical_face(height: float, at: float) -> None:
    line = polyline(sorted_columns(step(height, at)), NOISE)
    upright = np.flatnonzero(np.diff(line[:, 0]) == 0)
    assert len(upright) == 1
    assert line[upright[0], 0] == pytest.approx(at, abs=0.006)
    assert line[upright[0] : upright[0] + 2, 1] == pytest.approx([0.0, height], abs=0.015)


def test_a_ramp_stays_a_ramp() -> None:
    x = np.arange(-0.5, 0.5, 0.025 / 20)
    ramp = np.column_stack([x, np.zeros(len(x)), 0.8 * x])
    line = polyline(sorted_columns(ramp), NOISE)
    assert (np.diff(line[:, 0]) > 0).all()
    assert line[:, 1] == pytest.approx(0.8 * line[:, 0], abs=0.002)


def test_gaps_and_ends_are_filled_and_marked() -> None:
    line = np.array([[0.0, 0.0], [0.05, 0.0], [0.25, 0.2], [0.25, 0.4], [0.3, 0.4]])
    points, filled = points_along(line, np.zeros(5, np.bool_), 0.02, 0.06, (-0.1, 0.4))
    x, z = points.T
    assert (np.diff(x) >= 0).all()
    assert x[0] == -0.1
    assert z[x < 0].tolist() == [0.0] * 5  # level before the first vertex
    assert filled[x < 0].all()
    assert z[x > 0.3] == pytest.approx(0.4)
    between = (x > 0.05) & (x < 0.25)
    assert filled[between].all()
    assert z[between] == pytest.approx(x[between] - 0.05)
    face = x == 0.25
    assert not filled[face].any()
    assert (z[face].min(), z[face].max()) == pytest.approx((0.2, 0.4))  # both ends of the face
    part, _ = points_along(line, np.zeros(5, np.bool_), 0.02, 0.06, (0.01, 0.27))  # lies within it
    inside = (x >= 0.01) & (x < 0.27)
    assert len(part) == pytest.approx(np.count_nonzero(inside), abs=1)
    assert (part[0, 0], part[-1, 0]) == pytest.approx((0.01, 0.27), abs=0.02)


def test_assumed_ground_stands_only_where_nothing_was_seen() -> None:
    seen = np.array([[0.0, 1.0], [0.1, 1.0]])
    assumed = np.array([[-0.5, 0.0], [0.02, 0.0], [0.06, 0.0]])
    line, unseen = with_assumed(seen, assumed, 0.03)
    assert line.tolist() == [[-0.5, 0.0], [0.0, 1.0], [0.06, 0.0], [0.1, 1.0]]
    assert unseen.tolist() == [True, False, True, False]
    alone, _ = with_assumed(np.zeros((0, 2)), assumed, 0.03)
    assert alone.tolist() == assumed.tolist()


def shadowed(edge: float, seen_from: float, depth: float) -> np.ndarray:
    """Return noisy points of a fall at ``edge``; none is behind it before ``seen_from``, (P, 3)."""
    points = step(-depth, edge)
    hidden = (points[:, 0] > edge + 0.01) & (points[:, 0] < seen_from)
    level = (points[:, 2] > -0.05) | (points[:, 2] < 0.05 - depth)
    return points[level & ~hidden]


def test_hidden_ground_falls_at_the_edge_that_hides_it() -> None:
    line = polyline(sorted_columns(shadowed(0.0, 0.3, 0.4)), NOISE)
    found, assumed = with_drops(line, np.zeros(len(line), np.bool_), 0.06, 0.0125)
    (face,) = np.flatnonzero(np.diff(found[:, 0]) == 0)
    assert found[face, 0] == pytest.approx(0.0, abs=0.026)
    assert found[face : face + 2, 1] == pytest.approx([0.0, -0.4], abs=0.03)
    points, filled = points_along(found, assumed, 0.02, 0.06, (-0.5, 0.5))
    behind = (points[:, 0] > 0.03) & (points[:, 0] < 0.28)
    assert filled[behind].all()
    assert points[behind, 1] == pytest.approx(np.full(behind.sum(), -0.4), abs=0.03)


def test_hidden_ground_that_falls_gently_is_a_straight_line() -> None:
    line = polyline(sorted_columns(shadowed(0.0, 0.3, 0.15)), NOISE)
    found, _ = with_drops(line, np.zeros(len(line), np.bool_), 0.06, 0.0125)
    assert len(found) == len(line)


def test_mixed_returns_at_the_end_of_a_shadow_are_no_face() -> None:
    rng = np.random.default_rng(8)
    ghosts = np.column_stack([np.full(30, 0.31), np.zeros(30), rng.uniform(-0.4, -0.1, 30)])
    points = np.concatenate([shadowed(0.0, 0.3, 0.4), ghosts])
    line = polyline(sorted_columns(points), NOISE)
    assert (np.diff(line[:, 0]) > 0).all()
