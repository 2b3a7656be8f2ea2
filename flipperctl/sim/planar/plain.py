"""The engine's inner loop through pymunk's public interface, the reference for ``compiled``.

Every contact of a track gets the tangential velocity of its belt. A belt's surface moves along the
outline, so that its velocity is v·(-n_y, n_x) for the contact normal n from track to ground. A
shape's ``surface_velocity`` cannot express this: it is one world vector that is projected on the
tangent, and it vanishes at a vertical face.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pymunk

from flipperctl.api import FloatArray, Limits
from flipperctl.sim.planar.joints import Budget, kinetic_energy, potential_energy, slowdown

TRACK, GROUND = 1, 2
"""Collision types of the tracks and of the ground."""


Bodies = tuple[pymunk.Body, pymunk.Body, pymunk.Body]
"""Bodies of the chassis, the front and the rear flippers."""


class Belt(NamedTuple):
    """Values that the callback sets at each contact of a track with the ground."""

    speed: float
    """Speed of the belt's surface along the outline [m/s]."""
    largest: float
    """Largest impulse that a contact caches from one substep for the next [N s]."""
    grip: float = math.inf
    """Sum of the normal impulses of a substep up to which friction alone limits the belts [N s].

    With more, the friction of the next substep is scaled down, so that all belts together push with
    no more than their motors' force. A belt that is held by its load slips as one that lacks grip.
    """


class PlainLoop:
    """Steps a space and samples the pose of the robot in it."""

    def __init__(
        self,
        space: pymunk.Space,
        bodies: Bodies,
        belt: Belt,
        budget: Budget,
        substep: float,
        substeps: int,
        gears: Sequence[pymunk.GearJoint] = (),
    ) -> None:
        """Drive the belts, with ``substeps`` of ``substep`` [s] per sample.

        ``gears``: the servos of the front and the rear flippers, or none.
        """
        self._space, self._bodies, self._budget = space, bodies, budget
        self._substep, self._substeps = substep, substeps
        self._inertia = np.array([[body.mass, body.moment] for body in bodies])
        self.work = 0.0
        """Work of the belts in the last sample, without their slip [J]."""
        self.spent = 0.0
        """Work of the servos since the start: in each sample the mean of the absolute torque times
        the angle by which the flipper turned, so that braking counts as driving does [J]."""
        self._gears = gears
        self._grip, self._pressed = belt.grip, 0.0
        self._share = 1.0
        self.drive(belt)

    def forget(self) -> None:
        """Forget the contacts of the last substep, before a run from another state."""
        self._pressed = 0.0

    def drive(self, belt: Belt) -> None:
        """Give every contact between a track and the ground the velocity of the belt."""
        speed, largest, _ = belt

        # Chipmunk recomputes the surface velocity of an arbiter in each substep, after the
        # collision and before `pre_solve`, which therefore sets it every time.
        def pre_solve(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
            normal = arbiter.normal
            if self._share < 1.0:
                arbiter.friction *= self._share
            arbiter.surface_velocity = (-speed * normal.y, speed * normal.x)
            for contact in _contacts(arbiter):
                if contact.jnAcc > largest:
                    contact.jtAcc *= largest / contact.jnAcc
                    contact.jnAcc = largest

        def post_solve(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
            for contact in _contacts(arbiter):
                self.work += speed * abs(contact.jtAcc)
                self._pressed += contact.jnAcc

        self._space.on_collision(TRACK, GROUND, pre_solve=pre_solve, post_solve=post_solve)

    def run(self, poses: FloatArray, limits: Limits) -> int:
        """Fill the rows of ``poses``, one per sample; return the number of filled rows.

        The run stops after the sample at which a limit is reached. ``poses`` is (S, 5): x [m],
        z [m], pitch, front and rear flipper angle [rad].
        """
        step, dt, (body, front, rear) = self._space.step, self._substep, self._bodies
        energy = sum(self._energies())
        turned = self._turned()
        for sample in range(len(poses)):
            self.work = 0.0
            impulses = [0.0] * len(self._gears)
            for _ in range(self._substeps):
                self._share = self._grip / self._pressed if self._pressed > self._grip else 1.0
                self._pressed = 0.0
                step(dt)
                for index, gear in enumerate(self._gears):
                    impulses[index] += gear.impulse
            before, turned = turned, self._turned()
            for impulse, old, new in zip(impulses, before, turned, strict=True):
                self.spent += impulse / (dt * self._substeps) * abs(new - old)
            energy = self._balance(energy)
            x, z = body.position
            angle = body.angle
            poses[sample] = x, z, angle, front.angle - angle, angle - rear.angle
            if limits.reached(x, z, angle):
                return sample + 1
        return len(poses)

    def _turned(self) -> list[float]:
        """Return the angle of each servo's flipper relative to the chassis [rad]."""
        chassis = self._bodies[0].angle
        flippers = self._bodies[1 : 1 + len(self._gears)]
        return [flipper.angle - chassis for flipper in flippers]

    def _energies(self) -> tuple[float, float]:
        """Return the kinetic and the potential energy of the robot [J]."""
        states = np.array(
            [
                (*body.position, body.angle, *body.velocity, body.angular_velocity)
                for body in self._bodies
            ]
        ).ravel()
        kinetic = kinetic_energy(states, self._inertia)
        gravity, _, _, _, *centre = self._budget
        return kinetic, potential_energy(states, self._inertia, gravity, *centre)

    def _balance(self, before: float) -> float:
        """Scale the velocities to remove excess energy; return the energy [J].

        ``before``: energy after the sample before [J].
        """
        kinetic, potential = self._energies()
        _, servos, belts, tolerance, *_ = self._budget
        supplied = servos + min(self.work, belts) + tolerance
        excess = kinetic + potential - (before + supplied)
        if excess <= 0.0:
            return kinetic + potential
        factor = slowdown(kinetic, excess)
        for body in self._bodies:
            vx, vz = body.velocity
            body.velocity = factor * vx, factor * vz
            body.angular_velocity *= factor
        return kinetic + potential - min(excess, kinetic)


def _contacts(arbiter: pymunk.Arbiter) -> Any:
    """Return the contacts of an arbiter, with the cached impulses that pymunk does not expose."""
    found = arbiter._arbiter
    return found.contacts[0 : found.count]
