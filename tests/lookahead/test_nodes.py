"""Predicted robots and decisions against those of the environment that plays the same actions."""

import numpy as np
import pytest

from flipperctl.api import LAST_PITCHES, Outcome, RewardTerm
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.lookahead.model import TARGETS, Model, Nodes, transitions
from flipperctl.lookahead.returns import History
from flipperctl.reward_sum import RewardSum
from tests.lookahead.scenes import FLAT, model_of, standing

NAMES = ("swing", "travel", "smoothness", "end")


def term(name: str) -> RewardTerm:
    found = resolver.create("reward", name, "rewards")
    assert isinstance(found, RewardTerm)
    return found


def true_node(env: FlipperEnv, model: Model) -> Nodes:
    """Return the environment's robot as if its episode began here."""
    state = env.state
    rates = float(state.velocity[0]), float(state.velocity[1]), state.pitch_rate
    pose = float(state.position[0]), float(state.position[1]), state.pitch
    found = model.state(pose, (state.front, state.rear), rates)
    found[TARGETS:] = env.drive.targets
    return Nodes.at_rest(found[None], state.position[None])


@pytest.mark.parametrize("terrain", ["flat", "step"])
def test_rewards_are_those_of_the_environment(terrain: str) -> None:
    """Each decision is predicted from the true state; only the past is that of predictions."""
    terms = {name: term(name) for name in NAMES}
    env = FlipperEnv(terrain, **{"rewards": {n: {"name": n} for n in NAMES}})
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
    model = model_of(FLAT)
    rates = (0.3, -0.1, 0.7)
    state = model.state((1.0, 0.5, 0.4), (0.9, -0.7), rates)
    robots = Nodes.at_rest(state[None], np.array([[1.0, 0.5]])).robots()
    assert robots.velocity[0] == pytest.approx(rates[:2])
    assert robots.pitch_rate[0] == rates[2]
    assert np.hypot(*(state[3:5] - rates[:2])) > 0.002  # the centre of mass moves differently


def test_parts_are_joined_and_taken_row_by_row() -> None:
    model = model_of(FLAT)
    parts = [standing(model, x) for x in (0.0, 1.0, 2.0)]
    joined = Nodes.joined(parts)
    assert len(joined) == 3
    some = joined.take(np.array([2, 0]))
    assert some.places[:, 0].tolist() == [2.0, 0.0]
    moved = some.moved_to(parts[1], np.array([1]))
    assert moved.places[:, 0].tolist() == [2.0, 1.0]
    assert some.places[:, 0].tolist() == [2.0, 0.0]


def test_the_past_of_a_policy_begins_with_its_episode() -> None:
    """As in the engine's transitions, where ``pitch`` averages over fewer changes at first."""
    history, model = History(), model_of(FLAT)
    node = standing(model, 0.0)
    for decisions in range(1, LAST_PITCHES + 3):
        history.saw(0.1 * decisions)
        past = history.node(node.states[0], node.places[0]).pitches
        assert past.shape == (1, min(decisions, LAST_PITCHES))
        assert past[0, -1] == pytest.approx(0.1 * decisions)
        branch = model.expand(node.states, node.states[:, TARGETS : TARGETS + 2], 0.6, poses=True)
        known = history.node(node.states[0], node.places[0]).after(branch, np.array([4]), 0.6)
        assert known.pitches.shape == (1, min(decisions + 1, LAST_PITCHES))


def test_the_terrain_that_flippers_are_compared_with_has_a_length() -> None:
    with pytest.raises(ConfigError, match=r"near=0.5 must be below far=0.45"):
        resolver.create("reward", {"name": "flipper", "near": 0.5}, "rewards")
