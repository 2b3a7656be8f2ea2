"""Belts: gives every contact of a track the belt's own tangential velocity.

A belt's surface runs along the outline, so with n the contact normal from track to ground its
velocity is v·(-n_y, n_x). A shape's ``surface_velocity`` cannot express this: it is one world
vector projected on the tangent and vanishes at a vertical face.
"""

from __future__ import annotations

from typing import Any

import pymunk

TRACK, GROUND = 1, 2
"""Collision types."""


def drive(space: pymunk.Space, speed: float) -> None:
    """Let every contact between a track and the ground move at ``speed`` [m/s].

    Chipmunk computes the surface velocity of an arbiter anew each substep, after the collision
    and before ``pre_solve``; so it is set there, each time.
    """

    def belt(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        x, y = arbiter.normal
        arbiter.surface_velocity = (-speed * y, speed * x)

    space.on_collision(TRACK, GROUND, pre_solve=belt)
