"""The paper's reward terms (Eqs. 4-7) and the candidate angle against numbers worked by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    RobotGeometry,
    RobotState,
    Transition,
    candidate_angle,
)
from flipperctl.config import resolver

ROBOT = RobotGeometry()  # hinges at ±0.28 m, tracks of radius 0.1 m
FLAT = Profile([(0.0, 0.0)])


def term(name: str, **settings: Any) -> RewardTerm:
    made = resolver.create("reward", {"name": name, **settings}, f"rewards.{name}")
    assert isinstance(made, RewardTerm)
    return made


def state(front: float = 0.0, pitch: float = 0.0, x: float = 0.0, z: float = 0.1) -> RobotState:
    return RobotState(np.array([x, z]), pitch, front, 0.0, np.zeros(2), 0.0, 0.0)


def transition(
    after: RobotState | None = None,
    *,
    pitches: tuple[float, ...] = (0.0, 0.0),
    profile: Profile = FLAT,
    outcome: Outcome | None = None,
) -> Transition:
    """Return a transition whose pitches are the last two of ``pitches``."""
    before, now = state(pitch=pitches[-2]), replace(after or state(), pitch=pitches[-1])
    return Transition(before, now, np.array(pitches), (0, 0), profile, ROBOT, outcome)


# Candidate angle


def candidate(*points: tuple[float, float], pitch: float = 0.0, **settings: Any) -> float:
    return candidate_angle(np.array(points).reshape(-1, 2), pitch, ROBOT, **settings)


def turned(point: tuple[float, float], angle: float) -> tuple[float, float]:
    x, z = point
    return (
        math.cos(angle) * x - math.sin(angle) * z,
        math.sin(angle) * x + math.cos(angle) * z,
    )


def test_flat_ground_asks_for_flat_flippers() -> None:
    ground = [(x, -0.1) for x in np.arange(-1.0, 1.0, 0.02)]
    assert candidate(*ground) == pytest.approx(0.0, abs=1e-9)
    assert candidate(*ground, rear=True) == pytest.approx(0.0, abs=1e-9)


# A point 0.4 m ahead of the hinge and 0.3 m above it is 0.5 m away:
# atan2(0.3, 0.4) + asin(0.1 / 0.5) = 0.64350 + 0.20136 = 0.84486.
def test_one_point_seen_from_the_hinge_with_the_track_s_radius_around_it() -> None:
    assert candidate((0.68, 0.3)) == pytest.approx(0.84486, abs=1e-5)


def test_the_rear_pair_mirrors_the_front_pair() -> None:
    assert candidate((-0.68, 0.3), rear=True) == pytest.approx(0.84486, abs=1e-5)
    assert candidate((-0.68, 0.3)) == 0.0
    assert candidate((0.68, 0.3), rear=True) == 0.0


@pytest.mark.parametrize("pitch", [0.3, -0.5])
def test_the_angle_is_in_the_frame_of_the_pitched_chassis(pitch: float) -> None:
    front, rear = turned((0.68, 0.3), pitch), turned((-0.68, 0.3), pitch)
    assert candidate(front, pitch=pitch) == pytest.approx(0.84486, abs=1e-5)
    assert candidate(rear, pitch=pitch, rear=True) == pytest.approx(0.84486, abs=1e-5)


def test_the_largest_angle_between_near_and_far_counts() -> None:
    # Of u in [0.1, 0.45] m ahead of the hinge at 0.28 m only the second and third points count.
    points = [(0.30, 0.3), (0.60, -0.1), (0.68, 0.3), (0.80, 0.9)]
    assert candidate(*points) == pytest.approx(0.84486, abs=1e-5)
    assert candidate(*points, far=0.35) == pytest.approx(0.0, abs=1e-9)  # (0.60, -0.1) alone
    assert candidate(*points, far=0.6) == pytest.approx(math.pi / 3)  # (0.80, 0.9) is too steep


def test_the_angle_is_clipped_to_the_reach_and_zero_without_points() -> None:
    assert candidate((0.48, 2.0)) == pytest.approx(math.pi / 3)
    assert candidate((0.48, -2.0)) == pytest.approx(-math.pi / 3)
    assert candidate() == 0.0


# R_flipper (Eq. 4). On flat ground the candidate is 0; π/36 = 0.08727 is free.


@pytest.mark.parametrize(
    ("front", "lambda_1", "value"),
    [
        (0.0, 1.0, 0.0),
        (0.08, 1.0, 0.0),
        (-0.08, 1.0, 0.0),
        (0.5, 1.0, -0.41273),  # 0.5 - 0.08727
        (-0.5, 1.0, -0.41273),
        (0.5, 2.0, -0.82547),
        (0.5, 3.0, -1.0),  # beyond 1/3 = 0.333
        (1.047, 1.0, -0.95973),
    ],
)
def test_the_front_flippers_pay_for_leaving_the_candidate(
    front: float, lambda_1: float, value: float
) -> None:
    paid = term("flipper", lambda_1=lambda_1)(transition(state(front=front)))
    assert paid == pytest.approx(value, abs=1e-5)


def test_the_tolerance_is_a_setting() -> None:
    paid = term("flipper", lambda_1=1.0, tolerance=0.0)(transition(state(front=0.08)))
    assert paid == pytest.approx(-0.08)


def test_the_candidate_comes_from_the_true_terrain_in_front() -> None:
    # Up from the corner at (0, 0.2) on, 0.4 m ahead of the hinge at x = -0.4, z = 0.1: the angle is
    # atan2(0.1, 0.4) + asin(0.1 / 0.41231) = 0.24498 + 0.24498 = 0.48996, and the face and the
    # ground before it are lower. Level flippers are off by 0.48996 - 0.08727 = 0.40269.
    step = Profile([(0.0, 0.0), (0.0, 0.2)])
    at = state(x=-0.68)
    narrow = {"lambda_1": 1.0, "near": 0.38, "far": 0.41}
    assert term("flipper", **narrow)(transition(at, profile=step)) == pytest.approx(
        -0.40269, abs=1e-4
    )
    right = replace(at, front=0.48996)
    assert term("flipper", **narrow)(transition(right, profile=step)) == 0.0


def test_the_candidate_is_in_the_frame_of_the_pitched_chassis() -> None:
    # Nose up by 0.1 over level ground, with the hinge as high above it as the radius: the ground
    # lies 0.1 below level in frame R. The centre is 0.28 sin(0.1) lower than the hinge.
    lifted = state(front=0.0, z=0.1 - 0.28 * math.sin(0.1))
    paid = term("flipper", lambda_1=1.0)(transition(lifted, pitches=(0.1, 0.1)))
    assert paid == pytest.approx(-(0.1 - math.pi / 36), abs=1e-6)


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
        ((0.76, 0.77, 0.78), -0.05),  # rising, but not so steep
    ],
)
def test_the_chassis_pays_for_its_swing(pitches: tuple[float, ...], value: float) -> None:
    paid = term("pitch", lambda_2=5.0, window=3)(transition(pitches=pitches))
    assert paid == pytest.approx(value)


def test_slope_and_window_of_the_swing_are_settings() -> None:
    swinging = transition(pitches=(0.0, 0.06, 0.0, 0.0))
    assert term("pitch", window=2, lambda_2=10.0)(swinging) == 0.0
    assert term("pitch", window=4, lambda_2=10.0)(swinging) == pytest.approx(-0.4)  # 10 · 0.12 / 3


# R_end (Eq. 7)


@pytest.mark.parametrize(
    ("outcome", "value"),
    [
        (None, 0.0),
        (Outcome.REACHED, 25.0),
        (Outcome.OVERTURNED, -25.0),
        (Outcome.STUCK, -25.0),
        (Outcome.TIMEOUT, -25.0),
    ],
)
def test_the_end_settles(outcome: Outcome | None, value: float) -> None:
    assert term("end", settlement=25.0)(transition(outcome=outcome)) == value
