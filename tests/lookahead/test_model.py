"""The prediction model: worked numbers, and engine and environment as judges."""

import math

import numpy as np
import pytest

from flipperctl.api import ACTIONS, LAST_PITCHES, ObservationLayout, Outcome, Profile, Robot
from flipperctl.config import resolver
from flipperctl.config.reward_sum import RewardSum
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.dynamics import MOST_EXACT, OVERTURNED, REACHED, RUNNING
from flipperctl.lookahead.model import FLIPPERS, TARGETS, Ground, Model, Nodes, transitions
from flipperctl.lookahead.search import History
from tests.lookahead.scenes import FLAT as LEVEL
from tests.lookahead.scenes import ROBOT, STEP, model_of, standing

FLAT = np.array([[0.0, 0.0]])
TURNS = np.array(ACTIONS) * ROBOT.angle_step
PERIOD = ROBOT.decision_period


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


@pytest.mark.parametrize(
    ("friction", "share", "climbs"),
    [(0.7, None, True), (0.3, None, False), (1.0, 1.2, True), (1.0, 0.8, False)],
)
def test_it_climbs_a_slope_if_friction_and_tracks_are_strong_enough(
    friction: float, share: float | None, climbs: bool
) -> None:
    slope = math.atan(0.5)
    force = None if share is None else share * ROBOT.mass * 9.81 * math.sin(slope)
    robot = ROBOT.model_copy(update={"track_force": force})
    model = Model(np.array([[-50.0, -25.0], [50.0, 25.0]]), robot, friction=friction)
    state = model.state((0.0, 0.1 / math.cos(slope), slope), (0.3, 0.3))
    assert (drive(model, state, 3.0)[0] > 0.3) == climbs


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


LOAD = {"payload": 15, "payload_x": 0.2, "payload_z": 0.3, "track_force": 400}


@pytest.mark.parametrize(
    ("terrain", "robot"),
    [("paper_stair", {}), ("rubble", LOAD)],
    ids=["paper_stair", "rubble with a load"],
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


@pytest.mark.parametrize("spacing", [0.5, 0.01])
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


# Poses within decisions, and the finish that only they can find


def before_the_step(model: Model) -> np.ndarray:
    """Return nine equal robots, the front flippers raised onto the edge, (9, STATE)."""
    state = model.state((-0.35, 0.1, 0.0), (0.6, 0.0), (0.2, 0.0, 0.0))
    return np.repeat(state[None], 9, axis=0)


@pytest.mark.parametrize("step", [0.005, 0.01, 0.02])
def test_they_lead_from_the_state_before_to_the_state_after_at_100_hz(step: float) -> None:
    model = Model(STEP.points, ROBOT, step=step)
    states = before_the_step(model)
    found = model.expand(states, states[:, TARGETS:] + TURNS, PERIOD, poses=True)
    assert found.poses.shape == (9, round(PERIOD * 100) + 1, 5)
    for poses, was, now in zip(found.poses, states, found.states, strict=True):
        for pose, state in ((poses[0], was), (poses[-1], now)):
            assert pose[:2] == pytest.approx(model.chassis(state))
            assert pose[2:] == pytest.approx(state[[2, FLIPPERS, FLIPPERS + 1]])
    front = found.poses[:, :, 3]  # turns at its rate, by 0.25 rad of 0.26 in a decision
    assert np.abs(np.diff(front)).max() == pytest.approx(0.01 * ROBOT.flipper_speed)


@pytest.mark.parametrize(("step", "tolerance"), [(0.01, 1e-12), (0.02, 1e-9), (0.005, 0.002)])
def test_their_pitch_variation_is_that_of_the_steps(step: float, tolerance: float) -> None:
    """Half steps lie between two poses, which miss a change of direction there."""
    model = Model(STEP.points, ROBOT, step=step)
    states = before_the_step(model)
    found = model.expand(states, states[:, TARGETS:] + TURNS, PERIOD, poses=True)
    variation = np.abs(np.diff(found.poses[:, :, 2])).sum(axis=1)
    assert variation == pytest.approx(found.pitch_variation, abs=tolerance)
    assert variation.max() > 0.05


def test_asking_for_them_changes_no_state() -> None:
    model = Model(STEP.points, ROBOT)
    states = before_the_step(model)
    targets = states[:, TARGETS:] + TURNS
    bare, posed = (model.expand(states, targets, PERIOD, poses=asked) for asked in (False, True))
    assert bare.poses.shape == (9, 0, 5)
    for name in ("states", "places", "pitch_variation", "steepest", "outcome"):
        assert np.array_equal(getattr(bare, name), getattr(posed, name)), name


@pytest.mark.parametrize(("angle", "z", "outcome"), [(0.0, 0.1, REACHED), (-1.0, 0.3827, RUNNING)])
def test_a_robot_past_the_finish_has_reached_it_unless_it_stands_on_its_flippers(
    angle: float, z: float, outcome: int
) -> None:
    model = model_of(LEVEL, finish=0.05)
    state = model.state((0.0, z, 0.0), (angle, angle), (0.2, 0.0, 0.0))
    found = model.expand(state[None], state[None, TARGETS:], PERIOD, poses=True)
    assert found.outcome.tolist() == [outcome]
    x = found.poses[0, :, 0]
    if outcome == REACHED:  # at the first step past it; the last pose is repeated
        assert 0.05 <= x[-1] < 0.056
        assert (x == x[-1]).sum() > 30
        assert found.places[0, 0] == x[-1]
        bare = model.expand(state[None], state[None, TARGETS:], PERIOD)
        assert bare.outcome.tolist() == [RUNNING]  # without poses, no robot reaches it
        assert bare.places[0, 0] > 0.1
    else:
        assert x[-1] > 0.1
        assert np.abs(np.diff(found.poses[0, :, 1])).max() < 0.002  # stands still


def test_an_overturned_robot_s_last_pose_is_repeated() -> None:
    model = Model(Profile([(0.0, -50.0)]).points, ROBOT)
    state = model.state((0.0, 0.0, 0.9), (0.0, 0.0), (0.0, 0.0, 1.0))
    found = model.expand(state[None], state[None, TARGETS:], PERIOD, poses=True)
    assert found.outcome.tolist() == [OVERTURNED]
    pitch = found.poses[0, :, 2]
    # From 0.9 to π/3 = 1.0472 at 1 rad/s takes 0.16 s in steps of 0.02 s.
    assert pitch[:17] == pytest.approx(0.9 + 0.01 * np.arange(17))
    assert (pitch[16:] == pitch[16]).all()


# Nodes and decisions, as reward terms see them


NAMES = ("swing", "travel", "smoothness", "end")


def true_node(env: FlipperEnv, model: Model) -> Nodes:
    """Return the environment's robot as if its episode began here."""
    state = env.state
    rates = float(state.velocity[0]), float(state.velocity[1]), state.pitch_rate
    pose = float(state.position[0]), float(state.position[1]), state.pitch
    found = model.state(pose, (state.front, state.rear), rates)
    found[TARGETS:] = env.drive.targets
    return Nodes.at_rest(found[None], state.position[None])


def test_rewards_are_those_of_the_environment() -> None:
    """Each decision is predicted from the true state; only the past is that of predictions."""
    terms = {name: resolver.create("reward", name, "rewards") for name in NAMES}
    env = FlipperEnv("step", **{"rewards": {n: {"name": n} for n in NAMES}})
    rng = np.random.default_rng(5)
    env.reset(seed=1)
    limit = env.drive.termination.limits
    model = Model(env.profile.points, env.robot, iterations=8, finish=limit.x, top=limit.top)
    node, row = true_node(env, model), np.array([0])
    own: list[list[float]] = []
    true: list[list[float]] = []
    outcome = None
    while outcome is None:
        action = int(rng.integers(9)) if rng.random() < 0.4 else 4
        *_, info = env.step(action)
        outcome = info.get("outcome")
        true.append([info["rewards"][name] for name in NAMES])
        targets = np.array([env.drive.targets])
        branch = model.expand(node.states, targets, env.robot.decision_period, poses=True)
        after = node.after(branch, np.array([action]), env.robot.decision_period)
        ts = transitions(node, after, branch, env.profile, env.robot)
        assert ts[0].action == env.transition.action
        assert ts[0].previous_action == env.transition.previous_action
        if outcome is None:
            assert ts[0].after.time == pytest.approx(env.state.time)
        own.append([float(RewardSum({n: t}).array(ts)[0]) for n, t in terms.items()])
        assert ts[0].outcome == outcome
        node = after.moved_to(true_node(env, model), row)
        recent = env.transition.pitches[-LAST_PITCHES:]
        assert node.pitches[0, -len(recent) :].tolist() == recent.tolist()
    assert outcome is Outcome.REACHED
    off = np.abs(np.array(own) - np.array(true))
    assert len(off) > 15
    assert (off.max(axis=0) <= [0.01, 0.06, 1e-12, 0.0]).all()
    total, predicted = np.sum(true, axis=0), np.sum(own, axis=0)
    assert predicted == pytest.approx(total, rel=0.05)
    assert (np.abs(total) > 0.3).all()


def test_the_velocity_is_that_of_the_chassis_centre() -> None:
    model = model_of(LEVEL)
    rates = (0.3, -0.1, 0.7)
    state = model.state((1.0, 0.5, 0.4), (0.9, -0.7), rates)
    robots = Nodes.at_rest(state[None], np.array([[1.0, 0.5]])).robots()
    assert robots.velocity[0] == pytest.approx(rates[:2])
    assert robots.pitch_rate[0] == rates[2]
    assert np.hypot(*(state[3:5] - rates[:2])) > 0.002  # the centre of mass moves differently


def test_the_past_of_a_policy_begins_with_its_episode() -> None:
    """As in the engine's transitions, where ``pitch`` averages over fewer changes at first."""
    history, model = History(), model_of(LEVEL)
    node = standing(model, 0.0)
    for decisions in range(1, LAST_PITCHES + 3):
        history.saw(0.1 * decisions)
        past = history.node(node.states[0], node.places[0]).pitches
        assert past.shape == (1, min(decisions, LAST_PITCHES))
        assert past[0, -1] == pytest.approx(0.1 * decisions)
        branch = model.expand(node.states, node.states[:, TARGETS : TARGETS + 2], 0.6, poses=True)
        known = history.node(node.states[0], node.places[0]).after(branch, np.array([4]), 0.6)
        assert known.pitches.shape == (1, min(decisions + 1, LAST_PITCHES))


# Heights around predicted places


@pytest.mark.parametrize("terrain", ["paper_stair", "gap", "rubble"])
def test_observations_are_those_of_the_environment(terrain: str) -> None:
    """Both take points every 0.02 m, one of which may lie in the bin beside an edge."""
    env = FlipperEnv(terrain)
    rng = np.random.default_rng(2)
    observation, _ = env.reset(seed=3)
    ground, model = (
        Ground(env.profile.extended(3.0, 3.0), env.layout),
        Model(env.profile.points, env.robot),
    )
    places, states, seen = [], [], []
    running = True
    while running and env.state.position[0] < env.drive.termination.finish:
        state = env.state
        x, z = state.position.tolist()
        places.append((x, z))
        states.append(model.state((x, z, state.pitch), (state.front, state.rear)))
        seen.append(observation)
        action = int(rng.integers(9)) if rng.random() < 0.3 else 4
        observation, _, terminated, truncated, _ = env.step(action)
        running = not (terminated or truncated)
    found = ground.observations(np.array(places), np.array(states))
    off = np.abs(found - np.array(seen))
    assert len(off) > 25
    assert off[:, -3:].max() == 0.0
    assert np.quantile(off, 0.95) < 0.005
    assert off.max() < 0.015


def test_a_bin_without_points_has_the_height_of_the_line_in_its_middle() -> None:
    """Many bins 0.012 m wide hold none of the points, which are 0.02 m apart."""
    layout = ObservationLayout(bins=15, bin_width=0.012)
    slope = np.array([[-1.0, -0.5], [1.0, 0.5]])
    place, state = np.array([[0.1, 0.3]]), np.zeros((1, 10))
    found = Ground(slope, layout).observations(place, state)[0, :-3].reshape(2, 15)
    middles = 0.1 + 0.012 * np.arange(-7, 8)
    for heights in found:
        assert heights == pytest.approx(
            middles / 2 - 0.3, abs=0.0031
        )  # half a bin, at a slope of 1/2


def test_level_ground_goes_on_beyond_both_ends() -> None:
    line = np.array([[0.0, 0.1], [1.0, 0.4]])
    places, state = np.array([[-5.0, 0.0], [9.0, 0.0]]), np.zeros((2, 10))
    found = Ground(line, ObservationLayout()).observations(places, state)[:, :-3]
    assert found[0] == pytest.approx(0.1)
    assert found[1] == pytest.approx(0.4)
