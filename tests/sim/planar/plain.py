"""The engine's inner loop through pymunk's public interface, which proves the compiled one."""

from typing import Any

import numpy as np
import pymunk

from flipperctl.api import FloatArray, Limits
from flipperctl.sim.planar.compiled import (
    GROUND,
    TRACK,
    Belt,
    Budget,
    kinetic_energy,
    potential_energy,
    slowdown,
)


class PlainLoop:
    """Takes and gives what ``CompiledLoop`` does."""

    def __init__(
        self,
        space: pymunk.Space,
        bodies: tuple[pymunk.Body, ...],
        belt: Belt,
        budget: Budget,
        substep: float,
        substeps: int,
        gears: tuple[pymunk.GearJoint, ...] = (),
    ) -> None:
        self._space, self._bodies, self._budget, self._gears = space, bodies, budget, gears
        self._substep, self._substeps, self._grip = substep, substeps, belt.grip
        self._inertia = np.array([[body.mass, body.moment] for body in bodies])
        self.work = self.spent = self._pressed = 0.0
        self._share = 1.0
        self.drive(belt)

    def forget(self) -> None:
        self._pressed = 0.0

    def drive(self, belt: Belt) -> None:
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
        dt, (body, front, rear) = self._substep, self._bodies
        energy, turned = sum(self._energies()), self._turned()
        for sample in range(len(poses)):
            self.work, impulses = 0.0, [0.0] * len(self._gears)
            for _ in range(self._substeps):
                self._share = self._grip / self._pressed if self._pressed > self._grip else 1.0
                self._pressed = 0.0
                self._space.step(dt)
                impulses = [i + g.impulse for i, g in zip(impulses, self._gears, strict=True)]
            before, turned = turned, self._turned()
            for impulse, old, new in zip(impulses, before, turned, strict=True):
                self.spent += impulse / (dt * self._substeps) * abs(new - old)
            energy = self._balance(energy)
            (x, z), angle = body.position, body.angle
            poses[sample] = x, z, angle, front.angle - angle, angle - rear.angle
            if limits.reached(x, z, angle):
                return sample + 1
        return len(poses)

    def states(self) -> FloatArray:
        states = [(*b.position, b.angle, *b.velocity, b.angular_velocity) for b in self._bodies]
        return np.array(states).ravel()

    def _turned(self) -> list[float]:
        return [b.angle - self._bodies[0].angle for b in self._bodies[1 : 1 + len(self._gears)]]

    def _energies(self) -> tuple[float, float]:
        flat, budget = self.states(), self._budget
        potential = potential_energy(
            flat, self._inertia, budget.gravity, budget.ahead, budget.above
        )
        return kinetic_energy(flat, self._inertia), potential

    def _balance(self, before: float) -> float:
        kinetic, potential = self._energies()
        supplied = self._budget.servos + min(self.work, self._budget.belts) + self._budget.tolerance
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
