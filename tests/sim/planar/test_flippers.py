"""The flippers: they turn at their rate, stop at their limit and lift what their torque can."""

import math

import pymunk
import pytest

from flipperctl.api import Profile, Robot, Start
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar.world import PlanarWorld

FLAT = Profile([(0.0, 0.0)])
STILL = 1e-9  # [m/s] belts that brake: the smallest speed that the settings allow


def run(world: PlanarWorld, seconds: float) -> None:
    for _ in range(round(100 * seconds)):
        world.advance()


@pytest.mark.parametrize("sign", [1, -1])
def test_flippers_turn_one_angle_step_in_one_decision(sign: int) -> None:
    world = PlanarWorld(FLAT, Robot(), Planar(), Start(0.0))
    target = sign * math.pi / 12
    world.command(target, target)
    run(world, 0.3)  # half of 15° / (25 °/s) = 0.6 s: they turn, they do not jump
    assert world.state().front == pytest.approx(target / 2, rel=0.03)
    run(world, 0.3)
    assert world.state().front == pytest.approx(target, rel=0.02)
    assert world.state().rear == pytest.approx(target, rel=0.02)


@pytest.mark.parametrize("engine", ["plain", "compiled"])
@pytest.mark.parametrize("sign", [1, -1])
def test_flippers_stop_at_their_limit(sign: int, engine: str) -> None:
    world = PlanarWorld(FLAT, Robot(track_speed=STILL), Planar(engine=engine), Start(0.0))
    world.command(sign * 1.5, sign * 1.5)
    run(world, 4.0)  # 25 °/s · 4 s = 100°
    limit = math.pi / 3
    assert world.state().front == pytest.approx(sign * limit, abs=5e-3)
    assert world.state().rear == pytest.approx(sign * limit, abs=5e-3)


def test_a_stop_that_is_not_touched_changes_nothing() -> None:
    free, stopped = (PlanarWorld(FLAT, Robot(), Planar(), Start(0.0)) for _ in range(2))
    for constraint in free.space.constraints:
        if isinstance(constraint, pymunk.RotaryLimitJoint):
            constraint.min, constraint.max = -math.pi, math.pi
    for world in (free, stopped):
        world.command(math.pi / 3, math.pi / 3)
        run(world, 3.0)
    assert stopped.state().front == pytest.approx(math.pi / 3, abs=1e-6)
    assert stopped.save()[0] == free.save()[0]


# Each pair carries half of 45 kg at 0.336 m, less its own weight at 0.168 m:
# 9.81 · (22.5 · 0.336 - 5 · 0.168) = 65.9 N m. On its tips, the chassis is
# 0.1 + 0.336 sin(π/3) = 0.391 m high.
@pytest.mark.parametrize(("settings", "height"), [({"flipper_torque": 60.0}, 0.1), ({}, 0.391)])
def test_flippers_lift_the_robot_only_with_enough_torque(
    settings: dict[str, float], height: float
) -> None:
    world = PlanarWorld(FLAT, Robot(track_speed=STILL, **settings), Planar(), Start(0.0))
    world.command(-math.pi / 3, -math.pi / 3)
    run(world, 5.0)
    assert world.position[1] == pytest.approx(height, abs=2e-3)


def test_starts_on_lowered_flippers() -> None:
    world = PlanarWorld(
        FLAT, Robot(track_speed=STILL), Planar(), Start(0.0, -math.pi / 6, -math.pi / 6)
    )
    assert world.position[1] == pytest.approx(0.1 + 0.336 / 2)  # sin 30° = 1/2
    assert world.penetration() == pytest.approx(0.0, abs=1e-9)
