"""The prediction model: worked numbers, and the engine as judge."""

import math

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Profile, Robot
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.dynamics import MOST_EXACT
from flipperctl.lookahead.model import FLIPPERS, TARGETS, Model

ROBOT = Robot()
FLAT = np.array([[0.0, 0.0]])


def drive(model: Model, state: np.ndarray, duration: float) -> np.ndarray:
    return model.expand(state[None], state[None, TARGETS:], duration).states[0]


def test_it_rests_and_drives_at_the_speed_of_its_belts() -> None:
    model = Model(FLAT, ROBOT)
    state = model.state((0.0, 0.1, 0.0), (0.3, 0.3))
    found = model.expand(state[None], state[None, TARGETS:], 3.0)
    x, z = found.places[0]
    assert x == pytest.approx(0.2 * 3.0, rel=0.02)
    assert z == pytest.approx(0.1, abs=0.002)
    assert found.pitch_variation[0] < 0.01


def test_a_flipper_turns_at_its_rate_and_stops_at_its_target() -> None:
    model = Model(FLAT, ROBOT)
    state = model.state((0.0, 0.1, 0.0), (0.3, 0.0))
    later = model.expand(state[None], np.array([[0.6, 0.0]]), 0.4).states[0]
    assert later[FLIPPERS] == pytest.approx(0.3 + 0.4 * ROBOT.flipper_speed)
    later = model.expand(state[None], np.array([[0.6, 0.0]]), 2.0).states[0]
    assert later[FLIPPERS] == pytest.approx(0.6)


@pytest.mark.parametrize(("friction", "climbs"), [(0.7, True), (0.3, False)])
def test_it_climbs_a_slope_below_its_friction_and_slides_above(
    friction: float, climbs: bool
) -> None:
    slope = math.atan(0.5)
    model = Model(np.array([[-50.0, -25.0], [50.0, 25.0]]), ROBOT, friction=friction)
    height = 0.1 / math.cos(slope)
    state = model.state((0.0, height, slope), (0.3, 0.3))
    state = drive(model, state, 3.0)
    assert (state[0] > 0.3) == climbs


@pytest.mark.parametrize(("share", "climbs"), [(1.2, True), (0.8, False)])
def test_it_climbs_a_slope_if_its_tracks_are_strong_enough(share: float, climbs: bool) -> None:
    slope = math.atan(0.5)
    force = share * ROBOT.mass * 9.81 * math.sin(slope)
    robot = ROBOT.model_copy(update={"track_force": force})
    model = Model(np.array([[-50.0, -25.0], [50.0, 25.0]]), robot)
    state = model.state((0.0, 0.1 / math.cos(slope), slope), (0.3, 0.3))
    state = drive(model, state, 3.0)
    assert (state[0] > 0.3) == climbs


def test_a_load_moves_the_centre_of_mass() -> None:
    robot = ROBOT.model_copy(update={"payload": 10.0, "payload_x": 0.3, "payload_z": 0.2})
    model = Model(FLAT, robot)
    state = model.state((0.0, 0.1, 0.0), (0.0, 0.0))
    assert state[0] == pytest.approx(10 * 0.3 / robot.mass)
    assert state[1] == pytest.approx(0.1 + 10 * 0.2 / robot.mass)
    assert model.chassis(state) == pytest.approx((0.0, 0.1))


def test_it_falls_as_gravity_says() -> None:
    model = Model(np.array([[0.0, -50.0]]), ROBOT)
    state = model.state((0.0, 0.0, 0.2), (0.5, -0.5), (0.3, 0.0, 0.1))
    later = drive(model, state, 1.0)
    assert later[1] - state[1] == pytest.approx(-9.81 / 2, rel=0.03)
    assert later[0] - state[0] == pytest.approx(state[3] * 1.0)
    assert later[2] - state[2] == pytest.approx(0.1)


def test_a_state_names_the_chassis_whatever_the_flippers_do() -> None:
    model = Model(FLAT, ROBOT)
    state = model.state((1.5, 0.4, 0.3), (0.9, -0.7))
    assert model.chassis(state) == pytest.approx((1.5, 0.4))
    assert math.hypot(state[0] - 1.5, state[1] - 0.4) > 0.003  # the centre of mass is elsewhere


LOAD = {"payload": 15, "payload_x": 0.2, "payload_z": 0.3, "track_force": 400}


@pytest.mark.parametrize(
    ("terrain", "robot"),
    [("paper_stair", {}), ("rubble", {}), ("uplift", {}), ("rubble", LOAD)],
    ids=["paper_stair", "rubble", "uplift", "rubble with a load"],
)
def test_one_decision_agrees_with_the_engine(terrain: str, robot: dict[str, float]) -> None:
    """Within a centimetre and 0.01 rad at the median over random decisions."""
    env = FlipperEnv(terrain, robot=robot)
    rng = np.random.default_rng(3)
    places, turns, variations = [], [], []
    for seed in range(2):
        env.reset(seed=seed)
        model = Model(env.profile.points, env.robot)
        while True:
            before = env.state
            rates = (*before.velocity.tolist(), before.pitch_rate)
            pose = (*before.position.tolist(), before.pitch)
            state = model.state(pose, (before.front, before.rear), rates)
            action = int(rng.integers(9)) if rng.random() < 0.5 else 4
            *_, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                break
            found = model.expand(state[None], np.array([env.drive.targets]), 0.6)
            places.append(np.hypot(*(found.places[0] - env.state.position)))
            turns.append(abs(found.states[0, 2] - env.state.pitch))
            variations.append(
                abs(found.pitch_variation[0] - np.abs(np.diff(env.drive.poses[:, 2])).sum())
            )
    assert len(places) > 20
    assert np.median(places) < 0.01
    assert np.median(turns) < 0.01
    assert np.median(variations) < 0.01


def test_equal_states_give_equal_futures_in_any_company() -> None:
    profile = Profile([(0, 0), (0, 0.2), (0.5, 0.2)])
    model = Model(profile.points, ROBOT)
    state = model.state((-0.7, 0.1, 0.0), (0.8, 0.0))
    targets = np.array([[0.3 * i, 0.3 * j] for i, j in ACTIONS])
    alone = [model.expand(state[None], t[None], 0.6).states[0] for t in targets]
    together = model.expand(np.repeat(state[None], 9, axis=0), targets, 0.6).states
    assert np.array_equal(together, alone)


@pytest.mark.parametrize("spacing", [0.5, 0.02, 0.01])
def test_ground_with_many_points_is_the_ground_with_few(spacing: float) -> None:
    """Both what lies inside of straight edges and bumps with more points than contacts before."""
    x = np.arange(-3, 6, spacing)
    bumps = 1e-5 * (np.arange(len(x)) % 2)
    for line in (np.column_stack([x, 0 * x]), np.column_stack([x, bumps])):
        model = Model(line, Robot(), contacts=MOST_EXACT)
        states = model.state((0.0, 0.1, 0.0), (0.0, 0.0))[None]
        for _ in range(5):
            states = model.expand(states, np.array([[-math.pi / 3, 0.0]]), 0.6).states
        assert model.chassis(states[0])[1] == pytest.approx(0.262, abs=0.005)
        assert math.degrees(states[0, 2]) == pytest.approx(15.3, abs=0.5)


@pytest.mark.parametrize(("period", "step"), [(0.11, 0.02), (0.05, 0.02), (0.6, 0.035)])
def test_a_decision_lasts_as_long_as_in_the_engine(period: float, step: float) -> None:
    model = Model(np.zeros((1, 2)), Robot(), step=step)
    state = model.state((0.0, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))
    after = model.expand(state[None], np.zeros((1, 2)), period)
    assert after.places[0, 0] == pytest.approx(0.2 * period, rel=0.02)
    poses = model.expand(state[None], np.zeros((1, 2)), period, poses=True).poses
    assert poses.shape[1] == round(100 * period) + 1
