"""Chipmunk alone, for the benchmark: a world's space stepped by the C function and nothing else.

Without its callback a belt stands still, so the tracks get Chipmunk's own constant surface
velocity instead. That one fails at risers; therefore a bare world never runs on by itself: it is
put back, decision by decision, where a world with real belts has been.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymunk import GearJoint, Vec2d

from flipperctl.sim.planar.compiled import step_alone
from flipperctl.sim.planar.plain import TRACK
from flipperctl.sim.planar.world import PlanarWorld

_NO_HANDLER = 0
"""A collision type for which nobody has set a callback."""


@dataclass(frozen=True)
class Moment:
    """Where each body is and what the servos hold, in the engine's terms and order."""

    bodies: tuple[tuple[Vec2d, float, Vec2d, float], ...]
    """Position [m], angle [rad], velocity [m/s], angular velocity [rad/s]."""
    phases: tuple[float, ...]
    """Targets of the flippers' servos [rad]."""


def moment(world: PlanarWorld) -> Moment:
    """What the world is at now."""
    return Moment(
        tuple((b.position, b.angle, b.velocity, b.angular_velocity) for b in world.space.bodies),
        tuple(c.phase for c in world.space.constraints if isinstance(c, GearJoint)),
    )


def strip(world: PlanarWorld) -> None:
    """Take the belts' callback away and let Chipmunk move the tracks' surfaces by itself."""
    for body in world.space.bodies:
        for shape in body.shapes:
            if shape.collision_type == TRACK:
                shape.collision_type = _NO_HANDLER
                shape.surface_velocity = (-world.robot.track_speed, 0.0)


def put(world: PlanarWorld, begin: Moment, phases: tuple[float, ...]) -> None:
    """Bodies as they were at the beginning of a decision, servos as that decision set them."""
    for body, state in zip(world.space.bodies, begin.bodies, strict=True):
        body.position, body.angle, body.velocity, body.angular_velocity = state
    gears = [c for c in world.space.constraints if isinstance(c, GearJoint)]
    for gear, phase in zip(gears, phases, strict=True):
        gear.phase = phase


def step(world: PlanarWorld, substeps: int) -> None:
    """Nothing but the engine's own step."""
    step_alone(world.space, world.sim.substep, substeps)


def contacts(world: PlanarWorld) -> int:
    """Points at which the robot touches the ground."""
    found: list[int] = []
    for body in world.space.bodies:
        body.each_arbiter(lambda arbiter: found.append(len(arbiter.contact_point_set.points)))
    return sum(found)
