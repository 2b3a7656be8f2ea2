"""Chipmunk alone, for the benchmark: a world's space stepped only by the C function.

Without the callback the belts would stand still, so the tracks get Chipmunk's own constant surface
velocity instead. That velocity fails at risers, so each decision of a bare world begins from the
snapshot of a world with real belts.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymunk import GearJoint, Vec2d

from flipperctl.sim.planar.compiled import step_alone
from flipperctl.sim.planar.plain import TRACK
from flipperctl.sim.planar.world import PlanarWorld

_NO_HANDLER = 0
"""A collision type without a callback."""


@dataclass(frozen=True)
class Snapshot:
    """State of each body and target of each servo, in the engine's units and order."""

    bodies: tuple[tuple[Vec2d, float, Vec2d, float], ...]
    """Position [m], angle [rad], velocity [m/s] and angular velocity [rad/s] of each body."""
    phases: tuple[float, ...]
    """Target angles of the flippers' servos [rad]."""


def snapshot(world: PlanarWorld) -> Snapshot:
    """Return the current state of the world."""
    return Snapshot(
        tuple((b.position, b.angle, b.velocity, b.angular_velocity) for b in world.space.bodies),
        tuple(c.phase for c in world.space.constraints if isinstance(c, GearJoint)),
    )


def strip(world: PlanarWorld) -> None:
    """Remove the belts' callback and give the tracks Chipmunk's own surface velocity."""
    for body in world.space.bodies:
        for shape in body.shapes:
            if shape.collision_type == TRACK:
                shape.collision_type = _NO_HANDLER
                shape.surface_velocity = (-world.robot.track_speed, 0.0)


def put(world: PlanarWorld, begin: Snapshot, phases: tuple[float, ...]) -> None:
    """Restore the bodies at the start of a decision, and set the servo targets of that decision."""
    for body, state in zip(world.space.bodies, begin.bodies, strict=True):
        body.position, body.angle, body.velocity, body.angular_velocity = state
    gears = [c for c in world.space.constraints if isinstance(c, GearJoint)]
    for gear, phase in zip(gears, phases, strict=True):
        gear.phase = phase


def step(world: PlanarWorld, substeps: int) -> None:
    """Take ``substeps`` steps of the engine alone."""
    step_alone(world.space, world.sim.substep, substeps)


def contacts(world: PlanarWorld) -> int:
    """Return the number of points at which the robot touches the ground."""
    found: list[int] = []
    for body in world.space.bodies:
        body.each_arbiter(lambda arbiter: found.append(len(arbiter.contact_point_set.points)))
    return sum(found)
