"""Offsets of the numbers in Chipmunk's structs that compiled code reads and writes.

In: the structs as pymunk's interface declares them. Out: offsets, and a check that they give the
same numbers as pymunk itself.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pymunk
from pymunk._chipmunk_cffi import ffi

from flipperctl.errors import ConfigError

_DOUBLE = 8  # bytes


def _double(struct: str, *path: str) -> int:
    """Return the offset of a number in one of Chipmunk's structs, in doubles."""
    return int(ffi.offsetof(struct, *path)) // _DOUBLE


NORMAL = _double("cpArbiter", "n", "x")
SURFACE = _double("cpArbiter", "surface_vr", "x")
FRICTION = _double("cpArbiter", "u")
CONTACTS = _double("cpArbiter", "contacts")
COUNT = int(ffi.offsetof("cpArbiter", "count")) // 4
NORMAL_IMPULSE = _double("struct cpContact", "jnAcc")
TANGENT_IMPULSE = _double("struct cpContact", "jtAcc")
CONTACT = int(ffi.sizeof("struct cpContact")) // _DOUBLE


def address(pointer: Any) -> int:
    """Return the address that a C pointer holds."""
    return int(ffi.cast("uintptr_t", pointer))


@cache
def check_layout() -> None:
    """Compare numbers of a contact, read by their offsets, with pymunk's own; once per process.

    Raises:
        ConfigError: they differ, so that compiled code would write to foreign memory.
    """
    answers: dict[str, Any] = {}
    if (found := _through_offsets(answers)) != answers:
        raise ConfigError(
            f"sim.engine: compiled cannot be used with pymunk {pymunk.version}: its contact has "
            f"{found} where pymunk itself has {answers}; set sim.engine=plain, or install another "
            "pymunk"
        )


def _through_offsets(answers: dict[str, Any]) -> dict[str, Any]:
    """Return numbers of a contact by their offsets; put pymunk's own into ``answers``."""
    found: dict[str, Any] = {}

    def read(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        normal = arbiter.normal
        arbiter.surface_velocity = (-0.5 * normal.y, 0.5 * normal.x)
        struct = arbiter._arbiter
        doubles = np.frombuffer(ffi.buffer(struct, ffi.sizeof("cpArbiter")), np.float64)
        counts = doubles.view(np.int32)
        pointer = int(doubles.view(np.uintp)[CONTACTS])
        surface = arbiter.surface_velocity
        answers.update(
            normal=(normal.x, normal.y),
            surface_velocity=(surface.x, surface.y),
            friction=arbiter.friction,
            contacts=len(arbiter.contact_point_set.points),
            address=address(struct.contacts),
        )
        found.update(
            normal=tuple(doubles[NORMAL : NORMAL + 2].tolist()),
            surface_velocity=tuple(doubles[SURFACE : SURFACE + 2].tolist()),
            friction=float(doubles[FRICTION]),
            contacts=int(counts[COUNT]),
            address=pointer,
        )

    def pressed(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        impulse = arbiter.total_impulse
        size = found["contacts"] * CONTACT * _DOUBLE
        if found != answers or not size:
            return  # the address may be wrong
        contacts = np.frombuffer(ffi.buffer(ffi.cast("char *", found["address"]), size))
        normal_part, tangent_part = (
            contacts[at::CONTACT].sum() for at in (NORMAL_IMPULSE, TANGENT_IMPULSE)
        )
        normal = np.array(answers["normal"])
        tangent = np.array([-normal[1], normal[0]])
        # Pymunk returns the impulse on the other body.
        found["impulse"] = tuple(
            np.round(normal_part * normal + tangent_part * tangent, 9).tolist()
        )
        answers["impulse"] = tuple(np.round(-np.array(impulse), 9).tolist())

    space = pymunk.Space()
    space.gravity = (0.0, -10.0)
    body = pymunk.Body(1.0, 1.0)
    body.position, body.velocity = (0.0, 0.05), (0.3, -0.1)
    shape = pymunk.Segment(body, (-1.0, 0.0), (1.0, 0.0), 0.1)
    ground = pymunk.Segment(space.static_body, (-5.0, -0.3), (5.0, 0.2), 0.0)
    shape.friction, ground.friction = 1.0, 0.75
    shape.collision_type = ground.collision_type = 1
    space.add(body, shape, ground)
    space.on_collision(1, 1, pre_solve=read, post_solve=pressed)
    space.step(0.005)
    return found
