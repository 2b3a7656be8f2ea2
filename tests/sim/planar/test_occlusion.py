"""Occlusion against lines of sight worked by hand; the eye is 0.4 m above the chassis centre."""

import numpy as np
import pytest

from flipperctl.api import FloatArray, Profile, RobotState, SensedGround
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.planar import PlanarSensor, TerrainSensor

TRENCH = Profile([(0.0, 0.0), (0.0, -0.3), (0.5, -0.3), (0.5, 0.0)])
WALL = Profile([(0.0, 0.0), (0.0, 0.6)])
FLAT = Profile([(0.0, 0.0)])


def sensor(profile: Profile, **settings: float | bool) -> TerrainSensor:
    """Return a sensor with a reach of 3 m and a point every 0.01 m, its mount at (0, 0.4) m."""
    fixed = {"bins": 6, "bin_width": 1.0, "density": 100.0, "mount_x": 0.0, "mount_z": 0.4}
    chosen = {"occlusion": True, "body_length": 0.0, **fixed, **settings}
    return TerrainSensor(profile, PlanarSensor.model_validate(chosen), margin=6.0)


def scan(of: TerrainSensor, x: float, z: float = 0.1, pitch: float = 0.0) -> SensedGround:
    state = RobotState(np.array([x, z]), pitch, 0.0, 0.0, np.zeros(2), 0.0, 0.0)
    return of.sense(state, np.random.default_rng(0))[0]


def seen(ground: SensedGround, x: float, z: float = 0.1) -> FloatArray:
    """Return the points that were seen, in world [m]."""
    assert ground.filled is not None
    return ground.points[~ground.filled] + (x, z)


def filled(ground: SensedGround, x: float, z: float = 0.1) -> FloatArray:
    """Return the points that were not seen, in world [m]."""
    assert ground.filled is not None
    return ground.points[ground.filled] + (x, z)


def test_the_floor_of_a_trench_is_not_seen_from_before_it() -> None:
    # From (-1, 0.5) the line over the edge (0, 0) falls 0.5 m a metre: it meets the far wall,
    # x = 0.5 m, at 0.5 - 1.5 · 0.5 = -0.25 m, and would meet the floor at x = 0.6 m.
    points = seen(scan(sensor(TRENCH), -1.0), -1.0)
    inside = points[(points[:, 0] > 0.001) & (points[:, 0] < 0.501)]
    assert inside[:, 0] == pytest.approx(0.5)
    assert inside[:, 1].min() == pytest.approx(-0.25, abs=0.01)
    assert (points[points[:, 0] < 0.001, 1] == 0).all()


def test_nearer_the_edge_a_part_of_the_floor_is_seen() -> None:
    # From (-0.2, 0.5) the line over the edge falls 2.5 m a metre: 0.8 m lower it is at x = 0.12 m.
    points = seen(scan(sensor(TRENCH), -0.2), -0.2)
    floor = points[points[:, 1] < -0.299]
    assert floor[:, 0].min() == pytest.approx(0.12, abs=0.011)
    assert floor[:, 0].max() == pytest.approx(0.5, abs=0.011)


def test_from_above_the_whole_trench_is_seen() -> None:
    ground = scan(sensor(TRENCH), 0.25)
    assert filled(ground, 0.25).size == 0
    plain, _ = sensor(TRENCH, occlusion=False).sense(
        RobotState(np.array([0.25, 0.1]), 0.0, 0.0, 0.0, np.zeros(2), 0.0, 0.0),
        np.random.default_rng(0),
    )
    assert np.array_equal(ground.points, plain.points)
    assert np.array_equal(ground.heights, plain.heights)
    assert plain.filled is None


def test_what_was_never_seen_is_a_straight_line_between_its_neighbours() -> None:
    points = filled(scan(sensor(TRENCH), -1.0), -1.0)
    # from (0, 0) to (0.5, -0.25): a fall of 0.5 m a metre, 0.559 m long, with points 0.01 m apart
    assert len(points) == pytest.approx(55, abs=2)
    assert points[:, 1] == pytest.approx(-0.5 * points[:, 0], abs=0.01)


def test_the_top_of_a_step_above_the_mount_is_not_seen_and_taken_as_level() -> None:
    of = sensor(WALL)
    ground = scan(of, -1.0)
    beyond = filled(ground, -1.0)
    assert seen(ground, -1.0)[:, 0].max() == pytest.approx(0.0, abs=1e-9)
    assert beyond[:, 0].max() == pytest.approx(2.0, abs=0.011)  # the reach of 3 m ahead
    assert np.ptp(beyond[:, 1]) == 0
    assert beyond[0, 1] == pytest.approx(0.6, abs=0.01)  # the upper end of the face
    # 0.3 m higher the mount at 0.8 m looks down on the top.
    assert filled(scan(of, -1.0, 0.4), -1.0).size == 0


def test_a_pitched_robot_carries_its_mount_back_and_down() -> None:
    # With the centre at 0.65 m, a level robot's mount is 1.05 m high and sees the top, 0.6 m high.
    # At a pitch of 90° it is behind the centre and as high; at 120° it is 0.4 · cos 120° = -0.2 m
    # above it, 0.45 m high, and the top is hidden.
    level = scan(sensor(WALL), -1.0, 0.65)
    assert seen(level, -1.0, 0.65)[:, 0].max() > 1.9
    back = scan(sensor(WALL), -1.0, 0.65, pitch=np.radians(90))
    assert seen(back, -1.0, 0.65)[:, 0].max() > 1.9
    down = scan(sensor(WALL), -1.0, 0.65, pitch=np.radians(120))
    assert seen(down, -1.0, 0.65)[:, 0].max() == pytest.approx(0.0, abs=1e-9)


def test_the_map_remembers() -> None:
    of = sensor(TRENCH)
    assert filled(scan(of, -1.0), -1.0).size > 0
    scan(of, 0.25)
    assert filled(scan(of, -1.0), -1.0).size == 0
    assert filled(scan(sensor(TRENCH), -1.0), -1.0).size > 0  # a new episode begins with nothing


def test_the_chassis_hides_the_ground_below_it() -> None:
    # The lines from (0, 0.5) past the ends (±0.38, 0.1) are 0.38 · 0.5 / 0.4 = 0.475 m out on the
    # ground; a flat ground is filled to what it is.
    ground = scan(sensor(FLAT, body_length=0.76), 0.0)
    hidden = filled(ground, 0.0)
    assert (hidden[:, 0].min(), hidden[:, 0].max()) == pytest.approx((-0.475, 0.475), abs=0.011)
    assert ground.points[:, 1] == pytest.approx(-0.1)


def test_an_edge_between_two_sampled_points_hides_the_ground_too() -> None:
    # A spike 0.06 m wide and 0.4 m high has points 0.18 m of outline apart; from (-1, 0.5) the line
    # over its tip falls 0.1 m a metre and would come down 4 m past it.
    spike = Profile([(0.0, 0.0), (0.03, 0.4), (0.06, 0.0)])
    points = seen(scan(sensor(spike, density=5.5, horizon=3.0), -1.0), -1.0)
    assert points[:, 0].max() < 0.06


def test_the_horizon_ends_view_and_filling() -> None:
    ground = scan(sensor(WALL, horizon=1.5), -1.0)
    assert ground.points[:, 0].max() == pytest.approx(1.5, abs=0.011)
    near = scan(sensor(WALL, horizon=0.5), -1.0)
    assert near.points[:, 0].max() == pytest.approx(0.5, abs=0.011)
    assert near.points[:, 1] == pytest.approx(-0.1)


def test_filled_points_carry_the_bias_and_noise_of_their_neighbours_and_never_drop_out() -> None:
    exact = filled(scan(sensor(WALL), -1.0), -1.0)
    biased = filled(scan(sensor(WALL, bias=0.05, dropout=0.9), -1.0), -1.0)
    assert biased - exact == pytest.approx(np.tile([0.0, 0.05], (len(exact), 1)))
    noisy = filled(scan(sensor(WALL, noise=0.05), -1.0), -1.0)
    assert np.ptp(noisy[:, 1]) == 0
    assert 0 < abs(noisy[0, 1] - exact[0, 1]) < 0.25


def test_a_mount_below_the_ground_sees_nothing() -> None:
    ground = scan(sensor(WALL, mount_x=0.5), -0.4)
    assert ground.points.shape == (0, 2)
    assert ground.heights.tolist() == 6 * [0.0]


def test_without_occlusion_the_numbers_are_those_of_the_outline_bit_for_bit() -> None:
    of = sensor(TRENCH, occlusion=False, noise=0.01, dropout=0.2, bias=0.02, mount_z=2.0)
    found = scan(of, -0.2)
    rng = np.random.default_rng(0)
    cloud = TRENCH.sample(0.01, 6.0)
    points = cloud[(cloud[:, 0] >= -3.2) & (cloud[:, 0] < 2.8)] - (-0.2, 0.1)
    points[:, 1] += 0.02
    points[:, 1] += rng.normal(0.0, 0.01, len(points))
    assert np.array_equal(found.points, points[rng.random(len(points)) >= 0.2])
    assert found.filled is None


def test_equal_seeds_give_equal_episodes() -> None:
    def observations() -> list[FloatArray]:
        env = FlipperEnv("stair", perception={"occlusion": True, "noise": 0.01, "dropout": 0.1})
        found = [env.reset(seed=4)[0], *(env.step(4)[0] for _ in range(4)), env.reset(seed=4)[0]]
        assert env.perception.filled is not None
        assert env.perception.filled.shape == (len(env.perception.points),)
        return [np.asarray(one) for one in found]

    one, other = observations(), observations()
    assert np.array_equal(one, other)
    assert np.array_equal(one[0], one[-1])  # the map of the first episode is forgotten
