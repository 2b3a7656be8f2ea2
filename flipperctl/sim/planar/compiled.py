"""The engine's inner loop as machine code, without Python between the decisions of a robot.

It steps Chipmunk through its C function. A compiled callback gives every contact of a track the
tangential velocity of its belt, v·(-n_y, n_x) for the contact normal n from track to ground, since
a belt's surface moves along the outline. A shape's ``surface_velocity`` cannot express this: it is
one world vector that is projected on the tangent, and it vanishes at a vertical face. The tests
compute the same numbers through pymunk's public interface.

The callback reads and writes numbers in Chipmunk's structs by their offsets, which pymunk's
interface declares; they are checked once per process.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import llvmlite.binding
import numpy as np
import pymunk
from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]  # numba's stubs lack carray
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from flipperctl.api import FloatArray, Limits
from flipperctl.api.engines import is_over
from flipperctl.errors import ConfigError
from flipperctl.sim.jit import cached
from flipperctl.sim.planar.joints import (
    GROUND,
    STATE,
    TRACK,
    Belt,
    Budget,
    kinetic_energy,
    potential_energy,
    slowdown,
)

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


def _c_function(name: str, signature: Any) -> Any:
    """Return a function of pymunk's C library for calls from compiled code."""
    llvmlite.binding.add_symbol(name, address(ffi.addressof(lib, name)))
    return types.ExternalFunction(name, signature)


_step = _c_function("cpSpaceStep", types.void(types.uintp, types.float64))
_read = _c_function("pmSpaceBodyGetIteratorFuncBatched", types.void(types.uintp, types.uintp))
_impulse = _c_function("cpConstraintGetImpulse", types.float64(types.uintp))
_write = _c_function("pmSpaceBodySetIteratorFuncBatched", types.void(types.uintp, types.uintp))


def _to_pointer(typing_context: Any, address: Any) -> Any:
    """Compile the cast of an address to a pointer that ``carray`` takes."""

    def cast(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.uintp), cast


_pointer: Any = intrinsic(_to_pointer)


@njit
def _contacts(arbiter: Any) -> Any:
    """Return the numbers of an arbiter's contacts, ``CONTACT`` for each contact."""
    count = carray(arbiter, (COUNT + 1,), dtype=np.int32)[COUNT]
    place = carray(arbiter, (CONTACTS + 1,), dtype=np.uintp)[CONTACTS]
    return carray(_pointer(place), (count * CONTACT,), dtype=np.float64)


_NUMBERS = max(NORMAL + 2, FRICTION + 1)
"""Leading numbers of an arbiter that ``_belt`` reads and writes."""


@cached(cfunc, types.void(types.voidptr, types.voidptr, types.voidptr))
def _belt(arbiter: Any, space: Any, belt: Any) -> None:
    """Set a contact's belt velocity and bound its cached impulses, before it is solved.

    ``belt``: speed [m/s], largest cached impulse [N s], work of the sample [J], share of the
    friction that the tracks' motors can use, and sum of the normal impulses [N s].
    """
    numbers = carray(arbiter, (_NUMBERS,), dtype=np.float64)
    speed, largest, _, share, _ = carray(belt, (5,), dtype=np.float64)
    if share < 1.0:
        numbers[FRICTION] *= share
    # If the ground is the first shape, normal and surface velocity both change sign.
    numbers[SURFACE] = -speed * numbers[NORMAL + 1]
    numbers[SURFACE + 1] = speed * numbers[NORMAL]
    contacts = _contacts(arbiter)
    for first in range(0, len(contacts), CONTACT):
        normal_impulse = contacts[first + NORMAL_IMPULSE]
        if normal_impulse > largest:
            contacts[first + NORMAL_IMPULSE] = largest
            contacts[first + TANGENT_IMPULSE] *= largest / normal_impulse


@cached(cfunc, types.void(types.voidptr, types.voidptr, types.voidptr))
def _work(arbiter: Any, space: Any, belt: Any) -> None:
    """Add a contact's largest work of the belt, after it is solved; ``belt`` as in ``_belt``."""
    numbers = carray(belt, (5,), dtype=np.float64)
    contacts = _contacts(arbiter)
    for first in range(0, len(contacts), CONTACT):
        numbers[2] += numbers[0] * abs(contacts[first + TANGENT_IMPULSE])
        numbers[4] += contacts[first + NORMAL_IMPULSE]


_is_over = cached(njit)(is_over)
_kinetic = cached(njit)(kinetic_energy)
_potential = cached(njit)(potential_energy)
_slowdown = cached(njit)(slowdown)


class _Access(NamedTuple):
    """Addresses and memory through which compiled code reads and writes the robot's bodies."""

    chassis: int
    front: int
    rear: int
    reading: int
    """pymunk's request to append the states of a body."""
    read: NDArray[np.int32]
    """Number of values in ``states`` that are filled, (1,)."""
    states: FloatArray
    """States of chassis, front and rear flippers in their order, flat; see ``energy.STATE``."""
    writing: int
    """pymunk's request to take the velocities of a body."""
    written: NDArray[np.int32]
    """Number of values in ``velocities`` that are taken, (1,)."""
    velocities: FloatArray
    """Velocity (x, z) [m/s] and angular velocity [rad/s] of the bodies, flat."""


@cached(njit)
def _read_states(bodies: _Access) -> None:
    bodies.read[0] = 0
    _read(bodies.chassis, bodies.reading)
    _read(bodies.front, bodies.reading)
    _read(bodies.rear, bodies.reading)


@cached(njit)
def _slow_down(bodies: _Access, factor: float) -> None:
    for body in range(3):
        for i in range(3):
            bodies.velocities[3 * body + i] = factor * bodies.states[STATE * body + 3 + i]
    bodies.written[0] = 0
    _write(bodies.chassis, bodies.writing)
    _write(bodies.front, bodies.writing)
    _write(bodies.rear, bodies.writing)


@cached(njit)
def _run(
    space: int,
    substep: float,
    substeps: int,
    bodies: _Access,
    inertia: FloatArray,
    belt: FloatArray,
    gravity: float,
    servos: float,
    belts: float,
    tolerance: float,
    ahead: float,
    above: float,
    grip: float,
    gears: NDArray[np.uintp],
    spent: FloatArray,
    poses: FloatArray,
    angle_limit: float,
    x_limit: float,
    top: float,
    half: float,
    slope: float,
    end: float,
    level: float,
) -> int:
    states = bodies.states
    _read_states(bodies)
    energy = _kinetic(states, inertia) + _potential(states, inertia, gravity, ahead, above)
    turned, impulses = np.zeros(len(gears)), np.zeros(len(gears))
    for gear in range(len(gears)):
        turned[gear] = states[STATE * (gear + 1) + 2] - states[2]
    for sample in range(len(poses)):
        belt[2] = 0.0
        impulses[:] = 0.0
        for _ in range(substeps):
            belt[3] = grip / belt[4] if belt[4] > grip else 1.0
            belt[4] = 0.0
            _step(space, substep)
            for gear in range(len(gears)):
                impulses[gear] += _impulse(gears[gear])
        _read_states(bodies)
        for gear in range(len(gears)):
            before, turned[gear] = turned[gear], states[STATE * (gear + 1) + 2] - states[2]
            spent[0] += impulses[gear] / (substep * substeps) * abs(turned[gear] - before)
        kinetic = _kinetic(states, inertia)
        potential = _potential(states, inertia, gravity, ahead, above)
        supplied = servos + min(belt[2], belts) + tolerance
        excess = kinetic + potential - (energy + supplied)
        energy = kinetic + potential
        if excess > 0.0:
            _slow_down(bodies, _slowdown(kinetic, excess))
            energy -= min(excess, kinetic)
        x, z, angle = states[0], states[1], states[2]
        poses[sample, 0], poses[sample, 1], poses[sample, 2] = x, z, angle
        poses[sample, 3] = states[STATE + 2] - angle
        poses[sample, 4] = angle - states[2 * STATE + 2]
        if _is_over(x, z, angle, angle_limit, x_limit, top, half, slope, end, level):
            return sample + 1
    return len(poses)


class CompiledLoop:
    """Steps a space and samples the pose of its robot."""

    def __init__(
        self,
        space: pymunk.Space,
        bodies: tuple[pymunk.Body, pymunk.Body, pymunk.Body],
        belt: Belt,
        budget: Budget,
        substep: float,
        substeps: int,
        gears: tuple[pymunk.GearJoint, ...] = (),
    ) -> None:
        """Drive the belts, with ``substeps`` of ``substep`` [s] per sample.

        ``bodies``: chassis, front and rear flippers; ``gears``: the servos of the flippers, or
        none.
        """
        check_layout()
        handler = lib.cpSpaceAddCollisionHandler(space._space, TRACK, GROUND)
        numbers = ffi.new("double[5]", [belt.speed, belt.largest, 0.0, 1.0, 0.0])
        handler.userData = numbers
        handler.preSolveFunc = ffi.cast("cpCollisionPreSolveFunc", _belt.address)
        handler.postSolveFunc = ffi.cast("cpCollisionPostSolveFunc", _work.address)
        velocity = lib.VELOCITY | lib.ANGULAR_VELOCITY
        read = _Batch(lib.POSITION | lib.ANGLE | velocity, 3 * STATE)
        write = _Batch(velocity, 9)
        chassis, front, rear = (address(body._body) for body in bodies)
        access = _Access(chassis, front, rear, *read.parts, *write.parts)
        self._memory = space, bodies, gears, numbers, read, write  # must live as long as the loop
        self._belt = np.frombuffer(ffi.buffer(numbers))
        self._spent = np.zeros(1)
        self._arguments = (
            *(address(space._space), substep, substeps, access),
            np.array([[body.mass, body.moment] for body in bodies]),
            self._belt,
            *budget,
            belt.grip,
            np.array([address(gear._constraint) for gear in gears], np.uintp),
            self._spent,
        )

    @property
    def work(self) -> float:
        """Work of the belts in the last sample, without their slip [J]."""
        return float(self._belt[2])

    @property
    def spent(self) -> float:
        """Work of the servos since the start [J].

        In each sample it is the mean of the absolute torque times the angle by which the flipper
        turned, so that braking counts as driving does.
        """
        return float(self._spent[0])

    def forget(self) -> None:
        """Forget the contacts of the last substep, before a run from another state."""
        self._belt[4] = 0.0

    def run(self, poses: FloatArray, limits: Limits) -> int:
        """Fill the rows of ``poses``, one per sample; return the number of filled rows.

        The run stops after the sample at which a limit is reached. ``poses`` is (S, 5): x [m],
        z [m], pitch, front and rear flipper angle [rad].
        """
        return int(_run(*self._arguments, poses, *limits))


class _Batch:
    """Memory through which pymunk's batch functions read or write values of bodies."""

    def __init__(self, fields: int, size: int) -> None:
        # Larger than needed, so that pymunk never reallocates it.
        numbers = ffi.new("double[]", 2 * size)
        array = ffi.new("pmFloatArray *", {"num": 0, "max": 2 * size, "arr": numbers})
        request = ffi.new("pmBatchedData *", {"fields": fields, "floatArray": array})
        self._memory = numbers, array, request
        count = np.frombuffer(ffi.buffer(ffi.addressof(array, "num")), np.int32)
        self.parts = address(request), count, np.frombuffer(ffi.buffer(numbers))
        """Address of the request, count of numbers (1,), numbers."""


@cached(njit)
def _steps(space: int, substep: float, count: int) -> None:
    for _ in range(count):
        _step(space, substep)


def step_alone(space: pymunk.Space, substep: float, count: int) -> None:
    """Step a space ``count`` times and do nothing else: an upper bound on the speed of ``run``."""
    _steps(address(space._space), substep, count)


@cache
def check_layout() -> None:
    """Compare numbers of a contact, read by their offsets, with pymunk's own; once per process.

    Raises:
        ConfigError: they differ, so that compiled code would write to foreign memory.
    """
    answers: dict[str, Any] = {}
    if (found := _through_offsets(answers)) != answers:
        raise ConfigError(
            f"sim=planar cannot be used with pymunk {pymunk.version}: its contact has {found} "
            f"where pymunk itself has {answers}; install another pymunk"
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
