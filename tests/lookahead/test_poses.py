"""Poses within predicted decisions, and the finish that only they can find."""

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Profile
from flipperctl.lookahead.dynamics import OVERTURNED, REACHED, RUNNING
from flipperctl.lookahead.model import FLIPPERS, TARGETS, Model
from tests.lookahead.scenes import FLAT, ROBOT, STEP, model_of

TURNS = np.array(ACTIONS) * ROBOT.angle_step
PERIOD = ROBOT.decision_period
ON_FLIPPERS = -1.0
"""Angle of lowered flippers, on which the chassis stands 0.38 m above the ground [rad]."""


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


@pytest.mark.parametrize(
    ("angle", "z", "outcome"), [(0.0, 0.1, REACHED), (ON_FLIPPERS, 0.3827, RUNNING)]
)
def test_a_robot_past_the_finish_has_reached_it_unless_it_stands_on_its_flippers(
    angle: float, z: float, outcome: int
) -> None:
    model = model_of(FLAT, finish=0.05)
    state = model.state((0.0, z, 0.0), (angle, angle), (0.2, 0.0, 0.0))
    found = model.expand(state[None], state[None, TARGETS:], PERIOD, poses=True)
    assert found.outcome.tolist() == [outcome]
    x = found.poses[0, :, 0]
    if outcome == REACHED:  # at the first step past it; the last pose is repeated
        assert 0.05 <= x[-1] < 0.056
        assert (x == x[-1]).sum() > 30
        assert found.places[0, 0] == x[-1]
    else:
        assert x[-1] > 0.1
        assert np.abs(np.diff(found.poses[0, :, 1])).max() < 0.002  # stands still


def test_without_poses_no_robot_reaches_the_finish() -> None:
    model = model_of(FLAT, finish=0.05)
    state = model.state((0.0, 0.1, 0.0), (0.0, 0.0), (0.2, 0.0, 0.0))
    found = model.expand(state[None], state[None, TARGETS:], PERIOD)
    assert found.outcome.tolist() == [RUNNING]
    assert found.places[0, 0] > 0.1


def test_an_overturned_robot_s_last_pose_is_repeated() -> None:
    model = Model(Profile([(0.0, -50.0)]).points, ROBOT)
    state = model.state((0.0, 0.0, 0.9), (0.0, 0.0), (0.0, 0.0, 1.0))
    found = model.expand(state[None], state[None, TARGETS:], PERIOD, poses=True)
    assert found.outcome.tolist() == [OVERTURNED]
    pitch = found.poses[0, :, 2]
    # From 0.9 to π/3 = 1.0472 at 1 rad/s takes 0.16 s in steps of 0.02 s.
    assert pitch[:17] == pytest.approx(0.9 + 0.01 * np.arange(17))
    assert (pitch[16:] == pitch[16]).all()
