"""Decisions in arrays: their shapes, the ground around each, and the form that calls the term."""

from typing import Any

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    RobotGeometry,
    RobotState,
    RobotStates,
    Shaping,
    Transition,
    Transitions,
    candidate_angle,
    candidate_angles,
)

ROBOT = RobotGeometry()
STEP = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.5)])


def state(x: float, **more: float) -> RobotState:
    fields = {"pitch": 0.1, "front": 0.2, "rear": 0.3, "pitch_rate": 0.0, "time": x, **more}
    return RobotState(position=np.array([x, 0.1]), velocity=np.array([0.2, 0.0]), **fields)


def transition(x: float, outcome: Outcome | None = None, **more: Any) -> Transition:
    fields = {"action": (1, -1), "previous_action": (0, 1), "profile": STEP, "robot": ROBOT, **more}
    return Transition(
        before=state(x - 0.1, roll=0.4),
        after=state(x, roll=0.5),
        pitches=np.array([0.0, x]),
        outcome=outcome,
        path=np.full((3, 3), x),
        flippers=np.full((3, 2), -x),
        **fields,
    )


def test_transitions_keep_what_each_one_has() -> None:
    given = [transition(0.5), transition(0.7, Outcome.REACHED), transition(0.9, Outcome.STUCK)]
    ts = Transitions.of(given)
    assert len(ts) == 3
    assert ts.ended.tolist() == [False, True, True]
    assert ts.reached.tolist() == [False, True, False]
    assert ts.after.roll.tolist() == [0.5, 0.5, 0.5]
    for one, again in zip(given, ts, strict=True):
        for name in ("pitches", "path", "flippers"):
            assert np.array_equal(getattr(one, name), getattr(again, name))
        for name in ("action", "previous_action", "outcome", "profile", "robot", "sample_period"):
            assert getattr(one, name) == getattr(again, name)
        for was, now in ((one.before, again.before), (one.after, again.after)):
            assert {**vars(was), "position": 0, "velocity": 0} == {
                **vars(now),
                "position": 0,
                "velocity": 0,
            }
            assert was.position.tolist() == now.position.tolist()
            assert was.velocity.tolist() == now.velocity.tolist()


@pytest.mark.parametrize(
    "other",
    [
        {"profile": Profile([(0, 0)])},
        {"robot": RobotGeometry(track_radius=0.09)},
        {"sample_period": 0.02},
    ],
)
def test_transitions_of_different_kinds_are_refused(other: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="differ in ground, robot"):
        Transitions.of([transition(0.5), transition(0.7, **other)])
    with pytest.raises(ValueError, match="one at least"):
        Transitions.of([])


def test_a_predicted_state_may_leave_out_what_the_side_plane_lacks() -> None:
    one, two = np.zeros(4), np.zeros((4, 2))
    states = RobotStates(
        position=two, pitch=one, front=one, rear=one, velocity=two, pitch_rate=one, time=one
    )
    assert (states.yaw.shape, states[3].side) == ((4,), 0.0)
    with pytest.raises(ValueError, match="time has the shape"):
        RobotStates(
            position=two, pitch=one, front=one, rear=one, velocity=two, pitch_rate=one, time=two
        )


# The ground


def test_heights_are_those_of_each_position() -> None:
    x = np.array([-5.0, -0.1, 0.0, 0.3, 1.0, 1.1])  # at 0 the top of the face
    assert STEP.heights(x) == pytest.approx([0.0, 0.0, 0.2, 0.29, 0.5, 0.5])
    assert STEP.heights(x).tolist() == [STEP.height(each) for each in x]
    assert Profile([(1.0, 0.3)]).heights(x).tolist() == [0.3] * 6


def test_the_ground_around_each_position_is_that_of_each_call() -> None:
    x, reach = np.array([-0.5, 0.0, 30.0, 0.97]), np.array([0.1, 0.3, 0.1, 0.25])
    around_x, around_z = STEP.around_each(x, reach)
    for i in range(4):
        expected = STEP.around(x[i], reach[i])
        found = np.column_stack([around_x[i], around_z[i]])
        assert np.array_equal(found[: len(expected)], expected)
        assert np.isnan(found[len(expected) :]).all()
        assert np.array_equal(np.column_stack(STEP.around_each(float(x[i]), reach[i])), expected)
    assert STEP.around_each(np.array([30.0]), 0.1)[0].shape == (1, 0)


@pytest.mark.parametrize("rear", [False, True])
def test_candidate_angles_are_those_of_each_call(rear: bool) -> None:
    rng = np.random.default_rng(1)
    x, z = np.sort(rng.uniform(-1, 1, (40, 60))), rng.uniform(-0.5, -0.2, (40, 60))
    x[:, 50:] = np.nan
    x[7] = np.nan  # no points
    pitch = rng.uniform(-1, 1, 40)
    found = candidate_angles(x, z, pitch, ROBOT, near=0.05, rear=rear)
    for i in range(40):
        points = np.column_stack([x[i], z[i]])[np.isfinite(x[i])]
        one = candidate_angle(points, pitch[i], ROBOT, near=0.05, rear=rear)
        assert found[i] == pytest.approx(one, abs=1e-12)
    assert found[7] == 0.0
    assert len(set(found.tolist())) > 10  # few are clipped


# Terms


class Slow(RewardTerm):
    """A term that computes one decision at a time."""

    plugin_name = "slow"

    def __call__(self, t: Transition) -> float:
        return float(t.after.position[0]) + t.action[0]


class Fast(Slow):
    """A term with an array form."""

    def array(self, ts: Transitions) -> np.ndarray:
        return ts.after.position[:, 0] + ts.action[:, 0]

    def __call__(self, t: Transition) -> float:
        return float(t.after.position[0]) + t.action[0]


class Changed(Fast):
    """A term that computes one decision anew."""

    def __call__(self, t: Transition) -> float:
        return 7.0


class Distance(Shaping):
    """A potential with an array form."""

    plugin_name = "distance"

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        return float(state.position[0])

    def potentials(self, states: RobotStates, profile: Profile, robot: RobotGeometry) -> np.ndarray:
        return states.position[:, 0]


class Doubled(Distance):
    """A potential that computes one state anew."""

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        return 2 * float(state.position[0])


class Constant(Distance):
    """Shaping that computes one decision anew."""

    def __call__(self, t: Transition) -> float:
        return 3.0


@pytest.mark.parametrize(
    ("term", "values"),
    [
        (Slow(), [1.5, 1.75]),
        (Fast(), [1.5, 1.75]),
        (Changed(), [7.0, 7.0]),  # not the array form that it inherits
        (Distance(gamma=0.5), [0.25 - 0.4, -0.65]),  # Φ = 0 after the outcome
        (Doubled(gamma=0.5), [0.5 - 0.8, -1.3]),
        (Constant(), [3.0, 3.0]),
    ],
)
def test_the_array_form_is_that_of_the_call(term: RewardTerm, values: list[float]) -> None:
    ts = Transitions.of([transition(0.5), transition(0.75, Outcome.STUCK)])
    assert term.array(ts) == pytest.approx(values)
    assert [term(t) for t in ts] == pytest.approx(values)
