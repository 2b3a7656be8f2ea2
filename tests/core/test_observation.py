"""Heights and gaps by hand, and what the simulator compiles of them bit for bit."""

import numpy as np
import pytest

from flipperctl.core import observation
from flipperctl.core.ground_map import kept_points
from flipperctl.core.observation import bin_heights, fill_gaps
from flipperctl.sim import ground as thinning
from flipperctl.sim.planar import rays


def test_heights_equal_a_plain_loop_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = np.column_stack([np.linspace(-1.125, 1.125, 113), rng.normal(0.0, 0.3, 113)])
        inside: list[list[float]] = [[] for _ in range(15)]  # Equation 1, bin by bin
        for x, z in points.tolist():
            inside[min(int((x + 1.125) / 0.15), 14)].append(z)
        looped = [sum(heights) / len(heights) for heights in inside]
        highest = [max(heights) for heights in inside]
        for add in (observation.add_heights, rays.add_heights):
            found = bin_heights(points, 15, 0.15, highest=True, add_heights=add)
            assert found.tolist() == looped + highest
            found = bin_heights(points, 15, 0.15, highest=False, add_heights=add)
            assert found.tolist() == looped


def test_an_empty_bin_takes_its_height_from_its_neighbours() -> None:
    points = np.array([[-2.0, 0.1], [0.0, 0.3], [0.2, 0.5]])  # bins 0 and 2; 1, 3, 4 are empty
    # 0.1, half way between, (0.3 + 0.5) / 2, and the last one known from there on
    means, tops = [0.1, 0.25, 0.4, 0.4, 0.4], [0.1, 0.3, 0.5, 0.5, 0.5]
    assert bin_heights(points, 5, 1.0, highest=False) == pytest.approx(means)
    assert bin_heights(points, 5, 1.0, highest=True) == pytest.approx(means + tops)
    assert bin_heights(np.empty((0, 2)), 3, 1.0, highest=True).tolist() == [0.0] * 6


def test_bins_and_frames_by_hand() -> None:
    assert observation.edges(4, 0.5).tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    # 2 m along the chassis and 1 m above it, with the nose 90° up: 1 m behind and 2 m up
    level = observation.to_level(np.array([[2.0, 1.0]]), np.pi / 2)
    assert level == pytest.approx(np.array([[-1.0, 2.0]]))


@pytest.mark.parametrize("span", [0.0, 0.05])
def test_thinning_is_the_same_compiled(span: float) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([np.sort(rng.uniform(0, 1, 200)), rng.normal(0.0, 0.003, 200)])
    points.setflags(write=False)  # as a profile's, for which the function is compiled already
    arguments = points, rng.random(200) < 0.05, 0.002, span
    keep = kept_points(*arguments)
    assert keep.tolist() == thinning.kept_points(*arguments).tolist()
    assert 2 < keep.sum() < 200


def test_filling_is_the_same_compiled() -> None:
    x = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    points = np.column_stack([x, x**2])
    arguments = points, np.array([0, 1, 2, 9, 10]), x != 0.1, 0.1, (-0.35, 1.25)
    (line, filled), compiled = fill_gaps(*arguments), rays.fill_gaps(*arguments)
    assert (line.tolist(), filled.tolist()) == (compiled[0].tolist(), compiled[1].tolist())
    assert line[~filled].tolist() == points[x != 0.1].tolist()
    # 0.35 m before, √(0.7² + 0.77²) = 1.04 m within and 0.25 m past the points: 3 + 10 + 2
    assert filled.sum() == 15
