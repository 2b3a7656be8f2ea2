"""Heights and gaps by hand, what the simulator compiles of them, and the map of the ground."""

import numpy as np
import pytest

from flipperctl.api import ObservationLayout, Profile
from flipperctl.core import observation
from flipperctl.core.ground_map import GroundMap, _averaged, kept_points
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


def test_sides_and_roll_stand_between_the_numbers_of_every_layout() -> None:
    assert (observation.heights(5, True, True), observation.heights(5, False, True)) == (30, 15)
    assert observation.angles(True) == ("roll", *observation.angles())
    plain = observation.assemble(np.arange(2.0), (0.1, 0.2), pitch=0.3)
    sided = observation.assemble(np.arange(6.0), (0.1, 0.2), pitch=0.3, roll=0.4)
    assert sided.tolist() == [*range(6), np.float32(0.4), *plain[-3:].tolist()]
    assert ObservationLayout(bins=5, sides=True).scale.tolist() == [*30 * [0.5], *4 * [np.pi / 3]]


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
    x = np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.5])
    points = np.column_stack([x, x**2])
    offered = (x != 0.1) & (x < 1.25)
    arguments = points, np.array([0, 1, 2, 9, 10, 15]), offered, 0.1, (-0.35, 1.25)
    (line, filled), compiled = fill_gaps(*arguments), rays.fill_gaps(*arguments)
    assert (line.tolist(), filled.tolist()) == (compiled[0].tolist(), compiled[1].tolist())
    assert line[~filled].tolist() == points[offered].tolist()
    # 0.35 m before the points and √(0.7² + 0.77²) = 1.04 m between them: 3 + 10. The last gap,
    # √(0.5² + 1.25²) = 1.35 m, has 13, of which 6 lie within 1.25 m.
    assert filled.sum() == 3 + 10 + 6


GROUND = Profile([(0, 0), (0, 0.2), (0.6, 0.2), (0.9, 0.4), (1.5, 0.4)])


def scan(x: float, z: float, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    points = GROUND.sample(0.02, 4.0) - (x, z)
    points = points[np.abs(points[:, 0]) < 1.125]
    points[:, 1] += np.random.default_rng(seed).normal(0.0, noise, len(points)) if noise else 0.0
    return points


def heights(line: np.ndarray, x: float, z: float, at: np.ndarray) -> np.ndarray:
    return np.interp(at, line[:, 0] + x, line[:, 1] + z)


def test_exact_points_are_the_ground_to_a_few_millimetres() -> None:
    ground = GroundMap(memory=10)
    ground.add(scan(0.3, 0.5), (0.0, 0.0))
    at = np.array([-0.5, -0.1, 0.1, 0.4, 0.75, 1.2])
    found = heights(ground.line(), 0.3, 0.5, at)
    assert found == pytest.approx([GROUND.height(x) for x in at], abs=0.005)
    assert ground.noise < 1e-6


def test_the_motion_between_scans_is_measured() -> None:
    ground = GroundMap(memory=10)
    ground.add(scan(0.0, 0.5), (0.0, 0.0))
    # The robot was expected to drive 0.12 m, but drove 0.05 m and rose by 0.03 m.
    assert ground.add(scan(0.05, 0.53), (0.12, 0.0)) == pytest.approx((0.05, 0.03), abs=0.006)


def test_a_few_points_displace_no_map() -> None:
    ground = GroundMap(memory=3)
    ground.add(scan(0.3, 0.5), (0.0, 0.0))
    before = ground.line()
    for _ in range(5):
        ground.add(np.array([[-0.5, 0.0], [-0.4, 0.0]]), (0.0, 0.0))
    assert np.array_equal(ground.line(), before)
    few = GroundMap(memory=3)  # where there is nothing better, they count, as many as memory says
    for step in range(5):
        few.add(np.array([[0.1 * step, 0.0], [0.1 * step + 0.05, 0.0]]), (0.0, 0.0))
    assert len(few._scans) == 3


def test_noise_is_measured_and_averaged_away() -> None:
    ground = GroundMap(memory=10)
    for step in range(8):
        ground.add(scan(0.05 * step, 0.5, noise=0.01, seed=step), (0.05, 0.0))
    assert ground.noise == pytest.approx(0.01, rel=0.3)
    at = np.linspace(-0.6, 1.3, 80)
    at = at[np.abs(at) > 0.04]  # apart from the face
    truth = np.array([GROUND.height(x) for x in at])
    error = heights(ground.line(), 0.35, 0.5, at) - truth
    single = GroundMap(memory=1)
    single.add(scan(0.35, 0.5, noise=0.01, seed=99), (0.0, 0.0))
    alone = heights(single.line(), 0.35, 0.5, at) - truth
    assert np.sqrt((error**2).mean()) < 0.008
    assert np.sqrt((error**2).mean()) < np.sqrt((alone**2).mean())


@pytest.mark.parametrize("before", [-1.0, 2.0])
def test_a_cell_with_a_face_has_the_ends_of_its_middle_seven_tenths(before: float) -> None:
    face = np.linspace(0.0, 1.0, 21)
    points = np.column_stack([np.repeat([0.01, 0.04], [5, 21]), [*[before] * 5, *face]])
    ends = (0.15, 0.85) if before < 0 else (0.85, 0.15)
    expected = [[0.01, before], *([0.04, end] for end in ends)]
    assert _averaged(points, 0.01) == pytest.approx(np.array(expected))


def test_without_points_the_guess_moves_the_map() -> None:
    ground = GroundMap(memory=10)
    assert len(ground.line()) == 0
    assert ground.add(np.empty((0, 2)), (0.1, 0.0)) == (0.1, 0.0)
    ground.add(scan(0.0, 0.5), (0.0, 0.0))
    before = ground.line()
    ground.add(np.empty((0, 2)), (0.1, 0.02))
    assert ground.line() == pytest.approx(before - (0.1, 0.02), abs=0.01)
