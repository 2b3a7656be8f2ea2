"""Belts: gives every contact of a track the belt's own tangential velocity.

A belt's surface runs along the outline, so with n the contact normal from track to ground its
velocity is v·(-n_y, n_x). A shape's ``surface_velocity`` cannot express this: it is one world
vector projected on the tangent and vanishes at a vertical face.
"""

from __future__ import annotations

from typing import Any

import pymunk
from pymunk._chipmunk_cffi import lib

TRACK, GROUND = 1, 2
"""Collision types."""


def drive(space: pymunk.Space, speed: float) -> None:
    """Let every contact between a track and the ground move at ``speed`` [m/s].

    Chipmunk computes the surface velocity of an arbiter anew each substep, after the collision
    and before ``pre_solve``; so it is set there, each time.
    """
    # Called three times a substep, so it reads and writes Chipmunk's own arbiter: the public
    # properties `normal` and `surface_velocity` do the same, and cost a sixth of the whole step.
    read, write = lib.cpArbiterGetNormal, lib.cpArbiterSetSurfaceVelocity

    def belt(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        raw = arbiter._arbiter
        normal = read(raw)
        write(raw, (-speed * normal.y, speed * normal.x))

    space.on_collision(TRACK, GROUND, pre_solve=belt)
