"""Sensing in the plane: heights, lines of sight, errors of a map and rays, worked by hand."""

import math

import numpy as np
import pytest

from flipperctl.api import FloatArray, Profile, RobotState, SensedGround
from flipperctl.config import EvalConfig
from flipperctl.evaluation.conditions import Conditions
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.sim.planar import PlanarSensor, TerrainSensor
from flipperctl.sim.planar.rays import distances
from flipperctl.sim.planar.sensing import NEAREST, MapErrors, MapErrorSize, correlated

FLAT = Profile([(0.0, 0.0)])
STEP = Profile([(0.0, 0.0), (0.0, 0.2)])


def sensor(profile: Profile, **settings: float) -> TerrainSensor:
    """Return a sensor with three bins of 1 m and a point every 0.1 m by default."""
    chosen = {"bins": 3, "bin_width": 1.0, "density": 10.0, **settings}
    return TerrainSensor(profile, PlanarSensor(**chosen), margin=3.0)


def state(x: float, z: float = 0.1, pitch: float = 0.0) -> RobotState:
    return RobotState(np.array([x, z]), pitch, 0.0, 0.0, np.zeros(2), 0.0, 0.0)


def look(of: TerrainSensor, x: float = 0.05, z: float = 0.3) -> SensedGround:
    """Return what is sensed from (x, z) [m]; the 0.05 keeps every point off the bins' edges."""
    return of.sense(state(x, z), np.random.default_rng(0))[0]


def test_heights_lie_below_the_chassis_centre_in_frame_l_which_stays_level() -> None:
    of = sensor(STEP)
    assert look(sensor(FLAT)).heights == pytest.approx([-0.3] * 6)
    # Middle bin, world x in [-0.45, 0.55): -0.4 … 0.0 are five points at 0 m; the face adds one
    # at 0.1 m and the corner at 0.2 m; 0.1 … 0.5 are five more at 0.2 m.
    # (0.1 + 0.2 + 5 · 0.2) / 12 = 0.10833 m, seen from 0.3 m.
    means, highest = look(of).heights.reshape(2, 3)
    assert means == pytest.approx([-0.3, 0.10833 - 0.3, 0.2 - 0.3], abs=1e-5)
    assert highest == pytest.approx([-0.3, 0.2 - 0.3, 0.2 - 0.3])
    assert look(sensor(STEP, highest=False)).heights.tolist() == means.tolist()
    # 1 m ahead and 0.2 m up on the step: the face is now in the rear bin.
    ahead = look(of, 1.05, 0.5)
    means, highest = ahead.heights.reshape(2, 3)
    assert means == pytest.approx([0.10833 - 0.5, -0.3, -0.3], abs=1e-5)
    assert highest == pytest.approx([-0.3] * 3)
    assert np.diff(ahead.points[:, 0]).min() >= 0


@pytest.mark.parametrize(("bins", "width"), [(3, 1.0), (15, 0.15), (7, 0.4)])
def test_points_and_heights_follow_the_number_and_width_of_bins(bins: int, width: float) -> None:
    ground, reach = look(sensor(FLAT, bins=bins, bin_width=width, density=100.0)), bins * width / 2
    assert ground.heights.shape == (2 * bins,)
    ends = ground.points[[0, -1], 0]
    assert ends == pytest.approx([-reach, reach], abs=0.011)
    assert len(ground.points) == pytest.approx(200 * reach, abs=1)


def test_terrain_beyond_the_horizon_is_not_seen_yet() -> None:
    wall = Profile([(1.0, 0.0), (1.0, 1.0)])
    near, far = look(sensor(wall, horizon=0.6)), look(sensor(wall))
    assert near.points[:, 0].max() < 0.6
    assert near.points[0, 0] == far.points[0, 0]  # behind the robot, every point stays in view
    assert near.points[:, 1].max() == pytest.approx(-0.3)
    assert far.points[:, 1].max() == pytest.approx(0.7)
    assert near.heights == pytest.approx([-0.3] * 6)


def test_noise_is_normal_in_height_alone_and_dropout_removes_its_fraction() -> None:
    clean, noisy, few = (
        look(sensor(FLAT, density=1000.0, **errors)).points
        for errors in ({}, {"noise": 0.02}, {"dropout": 0.3})
    )
    error = noisy - clean
    assert len(error) == pytest.approx(3000, abs=1)
    assert not error[:, 0].any()
    # 3000 draws: the mean varies by 0.02 / √3000 = 0.0004, the deviation 0.02 / √6000 = 0.0003
    assert error[:, 1].mean() == pytest.approx(0.0, abs=0.0016)
    assert error[:, 1].std() == pytest.approx(0.02, abs=0.0012)
    # 3000 · 0.7 = 2100 remain, ± √(3000 · 0.3 · 0.7) = 25
    assert len(few) == pytest.approx(2100, abs=100)
    assert np.isin(few[:, 0], clean[:, 0]).all()


# Lines of sight; the eye is 0.4 m above the chassis centre

TRENCH = Profile([(0.0, 0.0), (0.0, -0.3), (0.5, -0.3), (0.5, 0.0)])
WALL = Profile([(0.0, 0.0), (0.0, 0.6)])


def masted(profile: Profile, **settings: float | bool) -> TerrainSensor:
    """Return a sensor with a reach of 3 m and a point every 0.01 m, its mount at (0, 0.4) m."""
    fixed = {"bins": 6, "bin_width": 1.0, "density": 100.0, "mount_x": 0.0, "mount_z": 0.4}
    chosen = {"occlusion": True, "body_length": 0.0, **fixed, **settings}
    return TerrainSensor(profile, PlanarSensor.model_validate(chosen), margin=6.0)


def scan(of: TerrainSensor, x: float, z: float = 0.1, pitch: float = 0.0) -> SensedGround:
    return of.sense(state(x, z, pitch), np.random.default_rng(0))[0]


def seen(ground: SensedGround, x: float, z: float = 0.1) -> FloatArray:
    """Return the points that were seen, in world [m]."""
    return ground.points[~ground.filled] + (x, z)


def filled(ground: SensedGround, x: float, z: float = 0.1) -> FloatArray:
    """Return the points that were not seen, in world [m]."""
    return ground.points[ground.filled] + (x, z)


def test_the_floor_of_a_trench_is_not_seen_from_before_it() -> None:
    # From (-1, 0.5) the line over the edge (0, 0) falls 0.5 m a metre: it meets the far wall,
    # x = 0.5 m, at 0.5 - 1.5 · 0.5 = -0.25 m, and would meet the floor at x = 0.6 m.
    points = seen(scan(masted(TRENCH), -1.0), -1.0)
    inside = points[(points[:, 0] > 0.001) & (points[:, 0] < 0.501)]
    assert inside[:, 0] == pytest.approx(0.5)
    assert inside[:, 1].min() == pytest.approx(-0.25, abs=0.01)
    assert (points[points[:, 0] < 0.001, 1] == 0).all()
    # What was never seen is a line from (0, 0) to (0.5, -0.25), 0.559 m long, 0.01 m a point.
    unseen = filled(scan(masted(TRENCH), -1.0), -1.0)
    assert len(unseen) == pytest.approx(55, abs=2)
    assert unseen[:, 1] == pytest.approx(-0.5 * unseen[:, 0], abs=0.01)
    # From (-0.2, 0.5) the line over the edge falls 2.5 m a metre: 0.8 m lower it is at x = 0.12 m.
    points = seen(scan(masted(TRENCH), -0.2), -0.2)
    floor = points[points[:, 1] < -0.299]
    assert (floor[:, 0].min(), floor[:, 0].max()) == pytest.approx((0.12, 0.5), abs=0.011)


def test_from_above_the_whole_trench_is_seen() -> None:
    ground, plain = scan(masted(TRENCH), 0.25), scan(masted(TRENCH, occlusion=False), 0.25)
    assert filled(ground, 0.25).size == 0
    assert np.array_equal(ground.points, plain.points)
    assert np.array_equal(ground.heights, plain.heights)
    assert plain.filled is None


def test_nothing_beyond_the_horizon_is_remembered_as_seen() -> None:
    of = masted(TRENCH, horizon=0.5)
    scan(of, -1.0)
    assert of._seen_ground is not None
    assert of._cloud[of._seen_ground.seen, 0].max() == pytest.approx(-0.5, abs=0.011)


def test_the_top_of_a_step_above_the_mount_is_not_seen_and_taken_as_level() -> None:
    of = masted(WALL)
    ground = scan(of, -1.0)
    beyond = filled(ground, -1.0)
    assert seen(ground, -1.0)[:, 0].max() == pytest.approx(0.0, abs=1e-9)
    assert beyond[:, 0].max() == pytest.approx(2.0, abs=0.011)  # the reach of 3 m ahead
    assert np.ptp(beyond[:, 1]) == 0
    assert beyond[0, 1] == pytest.approx(0.6, abs=0.01)  # the upper end of the face
    # 0.3 m higher the mount at 0.8 m looks down on the top.
    assert filled(scan(of, -1.0, 0.4), -1.0).size == 0
    assert seen(scan(masted(WALL), 1.0, 0.0), 1.0, 0.0).size == 0  # the mount is below the top
    # From the top, 0.5 m above it, all of it is seen: from 0 to 3 m ahead of 1.005 m.
    top = seen(scan(masted(WALL), 1.005, 0.7), 1.005, 0.7)
    assert top[np.isclose(top[:, 1], 0.6), 0].max() == pytest.approx(4.0, abs=0.011)


def test_a_pitched_robot_carries_its_mount_back_and_down() -> None:
    # With the centre at 0.65 m, a level robot's mount is 1.05 m high and sees the top, 0.6 m high.
    # At a pitch of 90° it is behind the centre and as high; at 120° it is 0.4 · cos 120° = -0.2 m
    # above it, 0.45 m high, and the top is hidden.
    level = scan(masted(WALL), -1.0, 0.65)
    assert seen(level, -1.0, 0.65)[:, 0].max() > 1.9
    back = scan(masted(WALL), -1.0, 0.65, pitch=np.radians(90))
    assert seen(back, -1.0, 0.65)[:, 0].max() > 1.9
    down = scan(masted(WALL), -1.0, 0.65, pitch=np.radians(120))
    assert seen(down, -1.0, 0.65)[:, 0].max() == pytest.approx(0.0, abs=1e-9)


def test_the_map_remembers() -> None:
    of = masted(TRENCH)
    assert filled(scan(of, -1.0), -1.0).size > 0
    scan(of, 0.25)
    assert filled(scan(of, -1.0), -1.0).size == 0
    assert filled(scan(masted(TRENCH), -1.0), -1.0).size > 0  # a new episode begins with nothing


def test_the_chassis_hides_the_ground_below_it() -> None:
    # The lines from (0, 0.5) past the ends (±0.38, 0.1) are 0.38 · 0.5 / 0.4 = 0.475 m out on the
    # ground; a flat ground is filled to what it is.
    ground = scan(masted(FLAT, body_length=0.76), 0.0)
    hidden = filled(ground, 0.0)
    assert (hidden[:, 0].min(), hidden[:, 0].max()) == pytest.approx((-0.475, 0.475), abs=0.011)
    assert ground.points[:, 1] == pytest.approx(-0.1)


def test_an_edge_between_two_sampled_points_hides_the_ground_too() -> None:
    # A spike 0.06 m wide and 0.4 m high has points 0.18 m of outline apart; from (-1, 0.5) the line
    # over its tip falls 0.1 m a metre and would come down 4 m past it.
    spike = Profile([(0.0, 0.0), (0.03, 0.4), (0.06, 0.0)])
    points = seen(scan(masted(spike, density=5.5, horizon=3.0), -1.0), -1.0)
    assert points[:, 0].max() < 0.06


def test_filled_points_carry_the_bias_and_noise_of_their_neighbours_and_never_drop_out() -> None:
    exact = filled(scan(masted(WALL), -1.0), -1.0)
    biased = filled(scan(masted(WALL, bias=0.05, dropout=0.9), -1.0), -1.0)
    assert biased - exact == pytest.approx(np.tile([0.0, 0.05], (len(exact), 1)))
    noisy = filled(scan(masted(WALL, noise=0.05), -1.0), -1.0)
    assert np.ptp(noisy[:, 1]) == 0
    assert 0 < abs(noisy[0, 1] - exact[0, 1]) < 0.25


# Errors of a map


LONG_STEP = Profile([(-6.0, 0.0), (0.0, 0.0), (0.0, 0.2), (6.0, 0.2)])


def sensed(of: TerrainSensor, x: float, rng: np.random.Generator) -> np.ndarray:
    return of.sense(state(x), rng)[0].points


def test_the_process_has_unit_variance_and_its_length() -> None:
    x = np.linspace(0.0, 3999.9, 40000)
    found = correlated(x, 0.2, np.random.default_rng(1))
    assert found.std() == pytest.approx(1.0, abs=0.03)
    for lag in (1, 3):
        got = np.mean(found[lag:] * found[:-lag])
        assert got == pytest.approx(np.exp(-lag * 0.5), abs=0.03)


def test_an_error_of_the_heights_stays_at_its_place() -> None:
    of = TerrainSensor(LONG_STEP, PlanarSensor(map_error=0.01), 3.0)
    rng = np.random.default_rng(3)
    first = sensed(of, -2.0, rng) + np.array([-2.0, 0.1])
    later = sensed(of, -1.4, rng) + np.array([-1.4, 0.1])
    assert 0.002 < np.abs(first[:, 1]).max() < 0.05
    both = (later[:, 0] > -2.5) & (later[:, 0] < -0.9)
    again = np.interp(later[both, 0], first[:, 0], first[:, 1])
    assert later[both, 1] == pytest.approx(again, abs=1e-9)


def test_what_was_passed_is_displaced_by_the_error_of_odometry_since() -> None:
    x = np.array([0.0, 1.0, 2.0])
    errors = MapErrors(x, MapErrorSize(0.0, 1.0, 0.04))
    rng, same = np.random.default_rng(5), np.random.default_rng(5)
    same.standard_normal(4)  # three heights, and the first decision, before the robot has moved
    errors.advance(0.5 - NEAREST, rng)
    errors.advance(1.5 - NEAREST, rng)  # now the points at 0 and 1 m are passed
    step = 0.04 * same.standard_normal()  # 1 m of the way
    errors.advance(1.6 - NEAREST, rng)
    last = 0.04 * np.sqrt(0.1) * same.standard_normal()
    points = np.column_stack([x, np.zeros(3)])
    errors.apply(points, slice(None))
    # The first was seen last before the first metre, the second before the last 0.1 m.
    assert points[:, 0] - x == pytest.approx([-step - last, -step - last, 0.0])


def test_the_position_is_the_true_one_with_the_error_of_odometry() -> None:
    rng = np.random.default_rng(5)
    exact, drifts = PlanarSensor(noise=0.01), PlanarSensor(map_drift=0.1)
    true, off = (TerrainSensor(LONG_STEP, one, 3.0) for one in (exact, drifts))
    for x in (-2.0, -1.0):
        position = true.sense(state(x), rng)[0].position
        assert position == pytest.approx(state(x).position)
        drifted = off.sense(state(x), rng)[0].position
    errors = off._map_errors
    assert errors is not None
    assert errors.error != 0
    assert drifted == pytest.approx(state(-1.0).position + np.array([errors.error, 0.0]))


def test_jitter_displaces_all_of_the_ground_anew_at_each_decision() -> None:
    x = np.array([0.0, 1.0, 2.0])
    errors = MapErrors(x, MapErrorSize(0.0, 1.0, 0.0, 0.01))
    rng, same = np.random.default_rng(5), np.random.default_rng(5)
    same.standard_normal(3)  # the heights
    for _ in range(3):
        errors.advance(0.5, rng)
        points = np.column_stack([x, np.zeros(3)])
        errors.apply(points, slice(None))
        _, drawn = same.standard_normal(2)  # the first one is odometry's
        assert points[:, 0] - x == pytest.approx([0.01 * drawn] * 3)
    saved = errors.save()
    errors.advance(0.5, rng)
    errors.load(saved)
    again = np.column_stack([x, np.zeros(3)])
    errors.apply(again, slice(None))
    assert np.array_equal(again, points)


def test_points_stay_in_order_and_within_reach_and_a_snapshot_repeats_them() -> None:
    for occlusion in (False, True):
        of = TerrainSensor(
            LONG_STEP, PlanarSensor(map_drift=0.3, map_jitter=0.1, occlusion=occlusion), 3.0
        )
        rng = np.random.default_rng(2)
        for x in np.arange(-2.0, 0.5, 0.12):
            points = sensed(of, x, rng)
            assert (np.diff(points[:, 0]) >= 0).all()
            assert (np.abs(points[:, 0]) <= 1.125).all()
        saved, bits = of.save(), rng.bit_generator.state
        once = sensed(of, 0.6, rng)
        of.load(saved)
        rng.bit_generator.state = bits
        assert np.array_equal(sensed(of, 0.6, rng), once)


def test_settings_of_a_map_count_in_the_hash_of_conditions_where_they_have_an_effect() -> None:
    def conditions(*words: str) -> Conditions:
        ((config, _),) = scenes(from_words(["terrain=step", *words]), None, "okada")
        return Conditions.of(config)

    plain, other, wrong = (
        Conditions.of(EvalConfig(terrain="step", perception=settings))
        for settings in ({}, {"map_length": 1.0}, {"map_error": 0.01})
    )
    assert "map_jitter" not in wrong.settings["perception"]
    assert "map_error" not in plain.settings["perception"]
    assert plain.hash == other.hash != wrong.hash
    widest = conditions("conditions=widest")
    longer, usual = (conditions("conditions=widest", f"perception.map_length={n}") for n in (4, 2))
    assert longer.settings["perception"]["map_length"] == 4
    assert longer.hash != widest.hash == usual.hash
    assert "map_length" not in widest.settings["perception"]  # as it was hashed


# Rays


LINE = np.array([(-5.0, 0.0), (0.0, 0.0), (0.0, 0.3), (1.0, 0.3), (1.0, -0.2), (5.0, -0.2)])


@pytest.mark.parametrize(
    ("direction", "reach", "expected"),
    [
        ((0, -1), 5, 0.1),  # down to the level
        ((1, 0), 5, 1.0),  # the face ahead
        ((1, 0), 0.9, math.inf),
        ((-1, 0), 5, math.inf),
        ((0.6, 0.8), 5, math.inf),  # above the edge
        ((0.8, 0.1), 5, 1.25),  # of a ray in 3-D that leads aside, the part in the plane
        ((0, 1), 5, math.inf),
    ],
)
def test_a_ray_ends_at_the_first_ground(
    direction: tuple[float, float], reach: float, expected: float
) -> None:
    (found,) = distances(LINE, np.array([-1.0, 0.1]), np.array([direction]), reach)
    assert found == pytest.approx(expected)
