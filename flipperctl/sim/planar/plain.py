"""The engine's inner loop through pymunk's public interface: the reference for ``compiled``.

Belts: every contact of a track gets the belt's own tangential velocity. A belt's surface runs
along the outline, so with n the contact normal from track to ground its velocity is
v·(-n_y, n_x). A shape's ``surface_velocity`` cannot express this: it is one world vector projected
on the tangent and vanishes at a vertical face.
"""

from __future__ import annotations

import math
from typing import Any

import pymunk

from flipperctl.api import FloatArray, Limits

TRACK, GROUND = 1, 2
"""Collision types."""


Bodies = tuple[pymunk.Body, pymunk.Body, pymunk.Body]
"""Chassis, front and rear flippers."""


class PlainLoop:
    """Steps a space and samples the pose of the robot in it."""

    def __init__(
        self, space: pymunk.Space, bodies: Bodies, speed: float, substep: float, substeps: int
    ) -> None:
        """``speed`` of the belts [m/s], ``substep`` [s], ``substeps`` from sample to sample."""
        self._space, self._bodies = space, bodies
        self._substep, self._substeps = substep, substeps
        self.drive(speed)

    def drive(self, speed: float) -> None:
        """Let every contact between a track and the ground move at ``speed`` [m/s]."""

        # Chipmunk computes the surface velocity of an arbiter anew each substep, after the
        # collision and before `pre_solve`; so it is set there, each time.
        def belt(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
            normal = arbiter.normal
            arbiter.surface_velocity = (-speed * normal.y, speed * normal.x)

        self._space.on_collision(TRACK, GROUND, pre_solve=belt)

    def run(self, poses: FloatArray, limits: Limits) -> int:
        """Run for one sample after the other, at most as many as ``poses`` has rows for.

        The run stops after the sample at which a limit is reached; returns how many samples there
        were. ``poses`` (S, 5) holds them: x [m], z [m], pitch, front and rear flipper angle [rad].
        """
        step, dt, (body, front, rear) = self._space.step, self._substep, self._bodies
        for sample in range(len(poses)):
            for _ in range(self._substeps):
                step(dt)
            x, z = body.position
            angle = body.angle
            poses[sample] = x, z, angle, front.angle - angle, angle - rear.angle
            if abs(angle) >= limits.angle:
                return sample + 1
            if x >= limits.x and z + limits.half * abs(math.sin(angle)) <= limits.top:
                return sample + 1
        return len(poses)
