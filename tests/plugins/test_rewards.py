"""The reward terms and the candidate angle against numbers worked by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    Robot,
    RobotGeometry,
    RobotState,
    Transition,
    Transitions,
    candidate_angle,
    registry,
)
from flipperctl.config import resolver
from flipperctl.testing.recorded import transitions_in_arrays

ROBOT = RobotGeometry()  # hinges at ±0.28 m, axles of 0.336 m, tracks of radius 0.1 m
FLAT = Profile([(0.0, 0.0)])
UP = math.pi / 3


def term(name: str, **settings: Any) -> RewardTerm:
    made = resolver.create("reward", {"name": name, **settings}, f"rewards.{name}")
    assert isinstance(made, RewardTerm)
    return made


@pytest.mark.parametrize(
    "name",
    [
        name
        for (kind, name), cls in registry.items()
        if kind == "reward" and cls.__module__.startswith("flipperctl_plugins.")
    ],
)
def test_many_decisions_are_as_one_bit_for_bit(name: str) -> None:
    for ts in transitions_in_arrays():
        assert term(name).array(ts).tolist() == [term(name)(t) for t in ts]


def paid(name: str, t: Transition, **settings: Any) -> float:
    return term(name, **settings)(t)


def state(
    x: float = 0.0,
    z: float = 0.1,
    *,
    pitch: float = 0.0,
    front: float = 0.0,
    rear: float = 0.0,
    rise: float = 0.0,
) -> RobotState:
    return RobotState(np.array([x, z]), pitch, front, rear, np.array([0.2, rise]), 0.0, 0.0)


def transition(after: RobotState, before: RobotState | None = None, **more: Any) -> Transition:
    fields = {"profile": FLAT, "robot": ROBOT, "action": (0, 0), "pitches": np.zeros(2), **more}
    return Transition(before or state(), after, **fields)


def decision(
    after: RobotState | None = None,
    *,
    pitches: tuple[float, ...] = (0.0, 0.0),
    profile: Profile = FLAT,
    outcome: Outcome | None = None,
) -> Transition:
    """Return a transition whose pitches are the last two of ``pitches``."""
    now = replace(after or state(), pitch=pitches[-1])
    more = {"pitches": np.array(pitches), "profile": profile, "outcome": outcome}
    return transition(now, state(pitch=pitches[-2]), **more)


# Candidate angle


def candidate(*points: tuple[float, float], pitch: float = 0.0, **settings: Any) -> float:
    return candidate_angle(np.array(points).reshape(-1, 2), pitch, ROBOT, **settings)


def turned(point: tuple[float, float], angle: float) -> tuple[float, float]:
    x, z = point
    return (math.cos(angle) * x - math.sin(angle) * z, math.sin(angle) * x + math.cos(angle) * z)


GROUND = [(x, -0.1) for x in np.arange(-1.0, 1.0, 0.02)]
AHEAD, BEHIND = (0.68, 0.3), (-0.68, 0.3)
"""0.4 m from the hinge and 0.3 m above it, 0.5 m away: atan2(0.3, 0.4) + asin(0.1 / 0.5) = 0.84486.
"""
# Of u in [0.1, 0.45] m ahead of the hinge at 0.28 m only the second and third points count.
SEVERAL = [(0.30, 0.3), (0.60, -0.1), (0.68, 0.3), (0.80, 0.9)]


@pytest.mark.parametrize(
    ("points", "settings", "angle"),
    [
        (GROUND, {}, 0.0),
        (GROUND, {"rear": True}, 0.0),
        ([AHEAD], {}, 0.84486),
        ([BEHIND], {"rear": True}, 0.84486),
        ([BEHIND], {}, 0.0),
        ([AHEAD], {"rear": True}, 0.0),
        ([turned(AHEAD, 0.3)], {"pitch": 0.3}, 0.84486),
        ([turned(BEHIND, -0.5)], {"pitch": -0.5, "rear": True}, 0.84486),
        (SEVERAL, {}, 0.84486),
        (SEVERAL, {"far": 0.35}, 0.0),  # (0.60, -0.1) alone
        (SEVERAL, {"far": 0.6}, math.pi / 3),  # (0.80, 0.9) is too steep
        ([(0.48, 2.0)], {}, math.pi / 3),
        ([(0.48, -2.0)], {}, -math.pi / 3),
        ([], {}, 0.0),
    ],
)
def test_the_candidate_is_the_largest_angle_to_the_inflated_terrain(
    points: list[tuple[float, float]], settings: dict[str, Any], angle: float
) -> None:
    assert candidate(*points, **settings) == pytest.approx(angle, abs=1e-5)


# R_flipper (Eq. 4). On flat ground the candidate is 0; π/36 = 0.08727 is free.


@pytest.mark.parametrize(
    ("front", "lambda_1", "value"),
    [
        (0.0, 1.0, 0.0),
        (-0.08, 1.0, 0.0),
        (0.5, 1.0, -0.41273),  # 0.5 - 0.08727
        (-0.5, 2.0, -0.82547),
        (0.5, 3.0, -1.0),  # beyond 1/3 = 0.333
    ],
)
def test_the_front_flippers_pay_for_leaving_the_candidate(
    front: float, lambda_1: float, value: float
) -> None:
    paid = term("flipper", lambda_1=lambda_1)(decision(state(front=front)))
    assert paid == pytest.approx(value, abs=1e-5)


def brute_force(profile: Profile, at: RobotState) -> float:
    """Return θ* over every disc of radius r on the outline, with 80 m of level ground around it."""
    x, z = (profile.sample(0.02, 80.0) - at.position).T
    ahead = math.cos(at.pitch) * x + math.sin(at.pitch) * z - ROBOT.hinge_offset
    up = math.cos(at.pitch) * z - math.sin(at.pitch) * x
    tangent = np.arctan2(up, ahead) + np.arcsin(np.minimum(1.0, 0.1 / np.hypot(ahead, up)))
    return ROBOT.clip(float(tangent[(ahead >= 0.1) & (ahead <= 0.45)].max()))


@pytest.mark.parametrize(
    ("points", "places"),
    [
        ([(0.0, 0.0)], (-20.0013, 0.0113, 3.4013, 55.0013)),
        ([(0.0, 0.0), (0.0, 0.2), (0.6, 0.2), (0.6, 0.0)], (-0.7013, 0.3113, 1.2013, 4.4013)),
        ([(0.0, 0.0), (2.0, 1.1), (2.0, 0.6)], (0.4013, 1.7013, 2.3013, 30.0013)),
        ([(0.0, 0.0), (3.0, -1.7), (3.2, -1.2)], (-3.6013, 1.1013, 2.7013, 7.0013)),
    ],
)
def test_the_candidate_is_that_of_all_discs_at_any_pitch(
    points: list[tuple[float, float]], places: tuple[float, ...]
) -> None:
    profile, degrees = Profile(points), [*range(-60, 61, 12), -57, -47, 47, 50, 57]
    poses = [
        state(x, profile.height(x) + 0.1 + 0.28 * abs(math.sin(pitch)), pitch=pitch, front=-2.0)
        for x in places
        for pitch in map(math.radians, degrees)
    ]
    decisions = [transition(pose, pose, profile=profile) for pose in poses]
    flipper = term("flipper", lambda_1=0.2, tolerance=0.0)  # the reward is -0.2 (θ* + 2)
    expected = [-0.2 * (brute_force(profile, pose) + 2.0) for pose in poses]
    assert [flipper(each) for each in decisions] == pytest.approx(expected, abs=1e-9)
    assert flipper.array(Transitions.of(decisions)).tolist() == list(map(flipper, decisions))


# R_pitch (Eqs. 5 and 6), λ2 = 5 per rad over the last three pitches


@pytest.mark.parametrize(
    ("pitches", "value"),
    [
        ((0.2, 0.2, 0.2), 0.0),
        ((0.0, 0.04, -0.02), -0.25),  # 5 · (0.04 + 0.06) / 2
        ((0.5, 0.0, 0.04, -0.02), -0.25),  # what lies further back is forgotten
        ((0.0, 0.04), -0.2),  # the first decision of an episode: 5 · 0.04
        ((0.0, 0.3, 0.0), -1.0),  # 0.3 is beyond 1/5
        ((0.79, 0.79, 0.80), -1.0),  # steeper than π/4 = 0.785 and rising
        ((-0.79, -0.79, -0.80), -1.0),  # on its tail as on its nose
        ((0.82, 0.81, 0.80), -0.05),  # steep, but falling: 5 · 0.01
        ((0.80, 0.80, 0.80), 0.0),  # steep, and staying so
        ((0.76, 0.77, 0.78), -0.05),  # rising, but not so steep
    ],
)
def test_the_chassis_pays_for_its_swing(pitches: tuple[float, ...], value: float) -> None:
    paid = term("pitch", lambda_2=5.0, window=3)(decision(pitches=pitches))
    assert paid == pytest.approx(value)


# R_end (Eq. 7)


@pytest.mark.parametrize(
    ("outcome", "value"), [(None, 0.0), (Outcome.REACHED, 25.0), (Outcome.TIMEOUT, -25.0)]
)
def test_the_end_settles(outcome: Outcome | None, value: float) -> None:
    assert term("end", settlement=25.0)(decision(outcome=outcome)) == value


# Progress


@pytest.mark.parametrize(
    ("distance", "value"), [(0.05, 0.25), (-0.1, -0.5), (0.3, 1.0), (-0.3, -1.0)]
)
def test_progress_pays_the_distance_forward(distance: float, value: float) -> None:
    moved = transition(state(1.0 + distance), state(1.0))
    assert paid("progress", moved, distance=0.2) == pytest.approx(value)


# Over 10 m, 2 m before the last edge Φ = -0.2 and 1.88 m before it -0.188: 0.9 · -0.188 + 0.2.
@pytest.mark.parametrize(
    ("begin", "end", "outcome", "value"),
    [
        (-2.0, -1.88, None, 0.0308),
        (-1.88, -2.0, None, 0.9 * -0.2 + 0.188),
        (-2.0, -1.88, Outcome.STUCK, 0.2),  # Φ = 0 after every outcome, good or bad
        (-12.0, -11.0, None, 0.1),  # both farther away than 10 m: -0.9 + 1
        (0.5, 0.6, None, 0.0),  # past all edges
    ],
)
def test_shaped_progress_is_the_change_of_potential(
    begin: float, end: float, outcome: Outcome | None, value: float
) -> None:
    moved = transition(state(end), state(begin), outcome=outcome)
    assert paid("shaped_progress", moved, gamma=0.9, distance=10.0) == pytest.approx(value)


# Swing


@pytest.mark.parametrize(
    ("pitches", "settings", "value"),
    [
        ([0.0, 0.1, 0.0, -0.05], {}, -0.25),  # it rocks by 0.1 + 0.1 + 0.05 rad
        ([0.0, 0.1, 0.0, -0.05], {"slope": 2.0}, -0.5),
        ([0.2, 0.2, 0.2], {}, 0.0),  # steep, but still
        ([0.0, 0.4, 0.0], {"slope": 2.0}, -1.0),  # 1.6, capped
        ([], {}, 0.0),  # a transition without a path
        ([0.0, 0.1, 0.0, -0.05], {"at_decisions": True}, -0.05),  # what lies between is not seen
        ([0.0, -0.05], {"at_decisions": True}, -0.05),
        ([0.3], {"at_decisions": True}, 0.0),
        ([], {"at_decisions": True}, 0.0),
    ],
)
def test_swing_costs_every_pitch_change_within_the_decision(
    pitches: list[float], settings: dict[str, float], value: float
) -> None:
    path = np.array([(0.0, 0.1, pitch) for pitch in pitches]).reshape(-1, 3)
    # Pitches at decisions are equal: the paper's term sees no swing.
    rocked = transition(state(), path=path, pitches=np.zeros(3))
    assert paid("swing", rocked, **settings) == pytest.approx(value)
    assert paid("pitch", rocked) == 0.0


# Flippers


@pytest.mark.parametrize(
    ("front", "rear", "value"),
    [
        (0.0, 0.0, 0.0),
        (math.pi / 12, -math.pi / 24, -0.75),  # one step and half a step, of two
        (-math.pi / 12, 0.0, -0.5),
        (math.pi / 6, math.pi / 12, -1.0),
    ],
)
def test_travel_is_the_angle_that_both_pairs_turned(
    front: float, rear: float, value: float
) -> None:
    turned = transition(state(front=0.1 + front, rear=rear - 0.2), state(front=0.1, rear=-0.2))
    assert paid("travel", turned) == pytest.approx(value)


def test_the_price_of_time_is_the_duration_of_a_decision() -> None:
    later = replace(state(), time=2.1), replace(state(), time=1.5)
    assert paid("time", transition(*later)) == pytest.approx(-0.6)


@pytest.mark.parametrize(
    ("before", "now", "value"),
    [
        ((0, 0), (0, 0), 0.0),
        ((1, -1), (1, -1), 0.0),  # turning at a constant rate costs nothing
        ((0, 0), (1, 0), -0.25),
        ((1, 1), (0, 0), -0.5),
        ((1, -1), (-1, 1), -1.0),
    ],
)
def test_smoothness_is_the_change_of_the_action(
    before: tuple[int, int], now: tuple[int, int], value: float
) -> None:
    assert paid("smoothness", transition(state(), action=now, previous_action=before)) == value


# Impact: up to 5 m/s² there is no penalty, 30 m/s² more cost 1.


def path(*heights: float) -> np.ndarray:
    return np.array([[0.0, z, 0.0] for z in heights])


@pytest.mark.parametrize(
    ("begin", "heights", "end", "value"),
    [
        (0.0, (0.1, 0.1, 0.1, 0.1), 0.0, 0.0),
        (-0.1, (0.103, 0.102, 0.101, 0.1, 0.1), 0.0, -5 / 30),  # 0.1 m/s lost in 0.01 s
        (-0.1, (0.103, 0.102, 0.101, 0.1), 0.0, -5 / 30),  # and at the decision's very end
        (0.2, (0.1, 0.101, 0.102), 0.1, -5 / 30),  # and at its very beginning
        (-0.3, (0.106, 0.103, 0.1, 0.1), 0.0, -25 / 30),
        (-0.5, (0.105, 0.1, 0.1), 0.0, -1.0),
        (0.0, (0.1, 0.1002, 0.1008), 0.08, 0.0),  # 0.02, 0.06 and 0.08 m/s: 4 m/s²
    ],
)
def test_impact_is_the_largest_vertical_acceleration(
    begin: float, heights: tuple[float, ...], end: float, value: float
) -> None:
    hit = transition(state(rise=end), state(rise=begin), path=path(*heights))
    assert paid("impact", hit, tolerance=5.0, worst=30.0) == pytest.approx(value, abs=1e-9)


def test_without_a_path_there_is_no_impact() -> None:
    assert paid("impact", transition(state(rise=-1.0))) == 0.0


# Stability, with contacts exactly at the ground


@pytest.mark.parametrize(
    ("flippers", "value"),
    [
        # Both pairs up: the support is the chassis' ±0.28 m, the centre of mass in its middle.
        ({"front": UP, "rear": UP}, -(1 - 0.28 / 0.4)),
        # The front pair level: its mass is at 0.28 + 0.168, the rear's at -(0.28 + 0.084), so the
        # centre at 0.111 · 0.084 = 0.00932, and the rear end of the support is the nearer.
        ({"front": 0.0, "rear": UP}, -(1 - 0.28932 / 0.4)),
        ({"front": 0.0, "rear": 0.0}, 0.0),
    ],
)
def test_stability_is_the_distance_to_the_nearer_end_of_the_support(
    flippers: dict[str, float], value: float
) -> None:
    t = transition(state(**flippers))
    assert paid("stability", t, enough=0.4, touch=1e-6) == pytest.approx(value, abs=1e-5)


@pytest.mark.parametrize(("x", "value"), [(-0.1, -0.5), (-0.02, -0.9), (0.1, -1.0), (-1.0, 0.0)])
def test_there_is_no_support_past_an_edge(x: float, value: float) -> None:
    brink = Profile([(-5.0, 1.0), (0.0, 1.0), (0.0, 0.0)])
    t = transition(state(x, 1.1, front=UP, rear=UP), profile=brink)
    assert paid("stability", t, enough=0.2, touch=1e-6) == pytest.approx(value, abs=1e-6)


# A load of 60 kg on 45 kg is 4/7 of the mass. At 0.3 m ahead it moves the centre by 0.171429 m.
def test_stability_includes_the_load() -> None:
    level = transition(state(front=UP, rear=UP), robot=Robot(payload=60, payload_x=0.3))
    ahead = -(1 - (0.28 - 0.171429) / 0.4)
    assert paid("stability", level, enough=0.4, touch=1e-6) == pytest.approx(ahead, abs=1e-5)
    behind = replace(level, robot=Robot(payload=60, payload_x=-0.3))
    assert paid("stability", behind, enough=0.4, touch=1e-6) == pytest.approx(ahead, abs=1e-5)


def test_centring_is_the_distance_from_the_middle_of_the_support() -> None:
    # Level flippers: the support reaches ±0.616 m, and the centre is 0.1 m above its middle. With a
    # load of 60 kg 0.3 m ahead it is 0.171429 m ahead of that: 0.198463 m in all.
    t = transition(state())
    assert paid("centring", t, far=0.5, touch=1e-6) == pytest.approx(-0.2, abs=1e-5)
    loaded = replace(t, robot=Robot(payload=60, payload_x=0.3))
    assert paid("centring", loaded, far=0.5, touch=1e-6) == pytest.approx(-0.396926, abs=1e-5)
    assert paid("centring", transition(state(0.0, 0.2)), far=0.5, touch=1e-6) == -1.0


# Clearance: a block 0.1 m high and 0.2 m wide under the chassis' middle


@pytest.mark.parametrize(
    ("height", "value"),
    [(0.3, 0.0), (0.22, -0.6), (0.2, -1.0)],  # gaps of 0.1, 0.02 and 0 m; 0.05 m is enough
)
def test_clearance_is_the_gap_over_a_bump(height: float, value: float) -> None:
    block = Profile([(-0.1, 0.0), (-0.1, 0.1), (0.1, 0.1), (0.1, 0.0)])
    t = transition(state(z=height), profile=block)
    assert paid("clearance", t, enough=0.05) == pytest.approx(value)
    assert paid("clearance", t, bump=0.15) == 0.0


# Nose up by 0.1 rad over the same block, the gap is smallest over its rear corner:
# in frame R it lies at 0.1 cos 0.1 - 0.3 cos 0.1 + 0.1 sin 0.1 ... = -(0.2 cos 0.1 - 0.1 sin 0.1).
def test_the_gap_is_measured_across_the_pitched_chassis() -> None:
    block = Profile([(-0.1, 0.0), (-0.1, 0.1), (0.1, 0.1), (0.1, 0.0)])
    gap = 0.2 * math.cos(0.1) - 0.1 * math.sin(0.1) - 0.1  # 0.089 m
    t = transition(state(z=0.3, pitch=0.1), profile=block)
    assert paid("clearance", t, enough=0.2) == pytest.approx(-(1 - gap / 0.2), abs=2e-3)


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_flat_ground_is_clear_at_any_slope(slope: float) -> None:
    ramp = Profile([(0.0, 0.0), (4.0, 4.0 * math.tan(slope))])
    lying = state(2.0, 2.0 * math.tan(slope) + 0.1 / math.cos(slope), pitch=slope)
    assert paid("clearance", transition(lying, profile=ramp)) == 0.0


def test_stability_is_that_at_the_end_of_the_decision() -> None:
    t = transition(state(z=0.1, front=UP, rear=UP), state(z=1.0))
    assert paid("stability", t) == 0.0
    assert paid("stability", replace(t, before=t.after, after=t.before)) == -1.0
