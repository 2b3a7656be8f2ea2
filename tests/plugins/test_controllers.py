"""Rules from the literature, each in cases that were worked by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from flipperctl_plugins.controllers.geometric import Geometric
from flipperctl_plugins.controllers.rules import Linear, Ohno, Okada
from flipperctl_plugins.controllers.sides import OkadaSides
from flipperctl_plugins.resting import Rest, rest
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, ObservationLayout, Perception, Robot

LAYOUT = ObservationLayout()
ROBOT = Robot()  # hinges at ±0.28 m, radius 0.1 m, flipper's axle 0.336 m
X = np.arange(-150, 151) * 0.01


def perceive(
    z: NDArray[np.floating], *, pitch: float = 0.0, front: float = 0.0, rear: float = 0.0
) -> Perception:
    """Return a perception of the ground z at each of ``X``, relative to the chassis centre [m]."""
    zeros = np.zeros(LAYOUT.size, np.float32)
    points = np.column_stack([X, z])
    rng = np.random.default_rng(0)
    return Perception(zeros, points, pitch, front, rear, ROBOT, LAYOUT, rng, recent=(zeros,))


def turns(action: int) -> tuple[int, ...]:
    """Return the turns of the front and the rear pair."""
    return tuple(ACTIONS[action])


def test_ohno_lays_both_pairs_on_the_ground_from_its_plane() -> None:
    # Along an even slope both pairs are straight, however the chassis is pitched: its axis is
    # 0.1 m above the ground, as the flippers' axles are.
    slope = 0.3
    z = slope * X - 0.1 * math.hypot(1, slope)
    for pitch in (0.0, 0.29, 0.6):
        p = perceive(z, pitch=pitch)
        assert [Ohno().angle(p, rear=r) for r in (False, True)] == pytest.approx([0, 0], abs=1e-6)
    # A wall of h = 0.3 m at s = 0.575 m: the plane through the points up to a = 0.73 m has the
    # slope 3/4 · h (a² - s²) / a³ = 0.117 (6.7°). Seen from there the wall's edge lies 0.32 m ahead
    # of the hinge and 0.13 m up: 22.2° + asin(0.1 / 0.345) = 39.0°. Behind, the nearest point of
    # the level counts, 0.109 m away and 0.054 m down: -26.5° + asin(0.1 / 0.122) = 28.6°.
    p = perceive(np.where(X > 0.575, 0.2, -0.1), pitch=0.5)
    angles = [math.degrees(Ohno().angle(p, rear=rear)) for rear in (False, True)]
    assert angles == pytest.approx([39.0, 28.6], abs=0.3)
    assert turns(Ohno().act(p)) == (1, 1)
    assert turns(Ohno(rear_gain=0).act(p)) == (1, 0)


def test_linear_weighs_the_pitch_and_the_height_at_the_tip() -> None:
    # The tips of level flippers end at 0.28 + 0.336 + 0.1 = 0.716 m: a step of 0.2 m begins there.
    z = np.where(X > 0.75, 0.1, -0.1)
    rule = Linear(
        front=0.1, front_pitch=-1, front_height=2, rear=-0.2, rear_pitch=2, rear_height=-1
    )
    p = perceive(z, pitch=0.1)
    # front 0.1 - 0.1 + 2 · 0.2 = 0.4 rad, rear -0.2 + 0.2 - 0.2 = -0.2 rad, steps of 0.26 rad
    assert turns(rule.act(p)) == (1, -1)
    assert turns(rule.act(perceive(z, pitch=0.1, front=0.4, rear=-0.2))) == (0, 0)
    assert turns(rule.act(perceive(z, pitch=0.1, front=0.26, rear=-0.05))) == (1, -1)
    # Past a tip 0.1 m away the step is not seen: front 0 rad, rear 0 rad.
    assert turns(rule.act(perceive(np.where(X > 0.83, 0.1, -0.1), pitch=0.1))) == (0, 0)


ANGLES = np.radians([-60.0, 0.0, 30.0])


def resting(z: NDArray[np.floating]) -> Rest:
    """Return the rest at x = 0 on the ground z at each of ``X`` [m], with each of ``ANGLES``."""
    found = rest(np.column_stack([X, z]), ROBOT, np.zeros(1), ANGLES, ANGLES)
    return Rest(*(values[0] for values in found))


def test_the_robot_rests_on_two_contacts() -> None:
    # Flat: level, the tips' centres 0.28 + 0.336 = 0.616 m from the robot's, which rises by
    # √(0.616² + 0.1²) - 0.1 = 0.524 m until it tips over one; over the hinges 0.197 m.
    flat = resting(np.full(len(X), -0.1))
    assert flat.pitch[1:, 1:] == pytest.approx(0, abs=1e-6)
    assert flat.height[1:, 1:] == pytest.approx(0, abs=1e-6)
    assert flat.margin[1, 1] == pytest.approx(0.524, abs=1e-3)
    assert flat.margin[2, 2] == pytest.approx(0.197, abs=1e-3)
    # The front pair 60° down: its tip is 0.336 · sin 60° = 0.291 m below the chassis' axis and
    # 0.28 + 0.168 m ahead, the level rear tip 0.616 m behind: atan(0.291 / 1.064) = 15.3°.
    assert math.degrees(flat.pitch[0, 1]) == pytest.approx(15.3, abs=0.1)
    assert math.degrees(flat.pitch[1, 0]) == pytest.approx(-15.3, abs=0.1)
    assert math.degrees(flat.pitch[0, 0]) == pytest.approx(0, abs=0.1)
    # An even slope: along it, whatever the flippers do above the chassis' axis.
    slope = resting(0.3 * X - 0.1 * math.hypot(1, 0.3))
    assert slope.pitch[1:, 1:] == pytest.approx(math.atan(0.3), abs=4e-3)
    assert slope.slope[1:, 1:] == pytest.approx(math.atan(0.3), abs=1e-3)
    # At 10° the axis of level flippers passes 0.1 m from an edge 0.2 m high and xe ahead, with the
    # rear tip's centre 0.1 m above the floor: 0.1 + 0.1 · cos 10° = (xe + 0.616 · cos 10°) ·
    # sin 10° for xe = 0.536 m.
    step = resting(np.where(X > 0.535, 0.1, -0.1))
    assert math.degrees(step.pitch[1, 1]) == pytest.approx(10, abs=0.2)


def test_geometric_plans_ahead() -> None:
    flat = np.full(len(X), -0.1)
    rule = Geometric()
    assert turns(rule.act(perceive(flat))) == (0, 0)
    # High on both pairs it comes down by both at once, which keeps the chassis level.
    high = flat - 0.336 * math.sin(math.radians(45))
    down = -math.radians(45)
    assert turns(rule.act(perceive(high, front=down, rear=down))) == (1, 1)
    # A wall beside the tips: the front pair is raised before it, which level flippers would hit.
    assert turns(rule.act(perceive(np.where(X > 0.75, 0.2, -0.1))))[0] == 1


def test_okada_keeps_its_margin() -> None:
    # Before a wall the front pair is raised, off the ground: the robot then tips over the front
    # hinge's arc, after a rise of √(0.28² + 0.1²) - 0.1 = 0.197 m; over level flippers 0.524 m.
    p = perceive(np.where(X > 0.85, 0.2, -0.1))
    assert [turns(Okada(far=0.6, margin=m).act(p)) for m in (None, 0.15, 0.25)] == [
        (1, 0),
        (1, 0),
        (0, 0),
    ]


def test_okada_sides_raises_the_flippers_before_a_wall_on_their_side() -> None:
    layout = LAYOUT.model_copy(update={"sides": True, "flippers": "four"})
    p = perceive(np.full(len(X), -0.1))
    # A wall of 0.3 m from the eleventh bin on, 0.45 m ahead: before the left tracks alone
    heights = np.full((3, 2, 15), -0.1, np.float32)
    heights[1, :, 11:] = 0.2
    seen = np.concatenate([heights.ravel(), np.zeros(6, np.float32)])
    four = replace(p, observation=seen, layout=layout, flippers=(0.0,) * 4)
    assert OkadaSides(far=0.6).act(four) == (1, 0, 0, 0)
    # Pairs take the mean of both sides; without sides, okada's turns
    pairs = replace(p, observation=seen, layout=layout)
    assert OkadaSides(far=0.6).act(pairs) == (1, 0)
    assert OkadaSides().act(p) == turns(Okada().act(p)) == (0, 0)
