"""The engine's inner loop as machine code: belts and energy balance of a robot.

It steps Chipmunk through its C function. A belt's surface moves along the outline. Therefore a
compiled callback gives every contact of a track the tangential velocity v·(-n_y, n_x), with the
normal n from track to ground. A shape's ``surface_velocity`` cannot express this: it is one world
vector that is projected on the tangent, and it vanishes at a vertical face. The tests compute the
same numbers through pymunk's public interface. The callback reads and writes numbers in Chipmunk's
structs by their offsets, which pymunk's interface declares; they are checked once per process.

Only servos and belts may add energy. Chipmunk corrects an error of a joint by a real velocity and
an overlap of bodies by a shift. When a robot is wedged between two faces, the two corrections
conflict; without bounds the solver's cached impulses grew to 9,000 N s, 200 times those of a hard
landing. When it comes free, the solver may not have converged, and gives the bodies velocities that
no force caused. Therefore the energy gained in each sample is compared with what servos and belts
can supply, and the velocities are scaled down to remove the excess.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pymunk
from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]  # numba's stubs lack carray
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Limits, Robot
from flipperctl.api.engines import is_over
from flipperctl.api.jit import c_function, cached
from flipperctl.errors import ConfigError

TRACK, GROUND = 1, 2
"""Collision types of the tracks and of the ground."""
STATE = 6
"""Numbers of a body: x, z [m], angle [rad], velocity (x, z) [m/s], angular velocity [rad/s]."""
TOLERANCE = 1.0
"""Gain of energy in a sample that is allowed beyond the work of servos and belts [J].

Contacts that are pushed apart lift the robot: by 2.3 mm with 1 J, at 45 kg.
"""
_TRACTION = 3.0
"""Largest force of all belts together in the energy balance, in weights of the robot [-].

The engine does not limit the belts' motors and may report any force in a wedge.
"""


class Belt(NamedTuple):
    """Values that a callback sets at each contact of a track with the ground."""

    speed: float  # speed of the belt's surface along the outline [m/s]
    largest: float  # largest impulse that a contact caches from one substep for the next [N s]
    grip: float = math.inf
    """Sum of the normal impulses of a substep up to which friction alone limits the belts [N s].

    With more, the friction of the next substep is scaled down, so that all belts together push with
    no more than their motors' force. A belt that is held by its load slips as one that lacks grip.
    """


class Budget(NamedTuple):
    """Constants of a robot's energy balance."""

    gravity: float  # downward acceleration [m/s²]
    servos: float  # largest work of both servos in a sample [J]
    belts: float  # largest work of all belts in a sample [J]
    tolerance: float  # gain in a sample that is allowed beyond that work [J]
    ahead: float = 0.0
    """Distance of the loaded chassis' centre of mass ahead of its centre, in frame R [m]."""
    above: float = 0.0  # height of that centre of mass above the chassis centre, in frame R [m]

    @classmethod
    def of(cls, robot: Robot, gravity: float) -> Budget:
        """Return the constants of a robot."""
        servos = 2 * robot.flipper_torque * robot.flipper_speed  # [W]
        belts = _TRACTION * (robot.mass * gravity) * robot.track_speed  # [W]
        work = servos * SAMPLE_PERIOD, belts * SAMPLE_PERIOD
        return cls(gravity, *work, TOLERANCE, *robot.centre_of_mass)


@cached(njit)
def kinetic_energy(states: FloatArray, inertia: FloatArray) -> float:
    """Return the kinetic energy of bodies [J].

    ``states``: ``STATE`` numbers of each body, flat. ``inertia``: mass [kg] and moment of inertia
    [kg m²] of each body, (B, 2).
    """
    energy = 0.0
    for body in range(len(inertia)):
        at = STATE * body
        vx, vz, turning = states[at + 3], states[at + 4], states[at + 5]
        mass, moment = inertia[body, 0], inertia[body, 1]
        energy += 0.5 * (mass * (vx * vx + vz * vz) + moment * turning * turning)
    return energy


@cached(njit)
def potential_energy(
    states: FloatArray, inertia: FloatArray, gravity: float, ahead: float, above: float
) -> float:
    """Return the potential energy of bodies, 0 at z = 0 [J]; see ``kinetic_energy``.

    ``ahead`` and ``above``: centre of mass of the first body in its own frame [m]. The other bodies
    have it at their positions.
    """
    energy = 0.0
    for body in range(len(inertia)):
        energy += inertia[body, 0] * gravity * states[STATE * body + 1]
    if ahead != 0.0 or above != 0.0:
        raised = math.sin(states[2]) * ahead + math.cos(states[2]) * above
        energy += inertia[0, 0] * gravity * raised
    return energy


@cached(njit)
def slowdown(kinetic: float, excess: float) -> float:
    """Return the factor on all velocities that takes ``excess`` [J] from ``kinetic`` [J]."""
    return math.sqrt(max(0.0, kinetic - excess) / kinetic)


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
    return c_function(name, address(ffi.addressof(lib, name)), signature)


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

    ``belt``: speed [m/s], largest cached impulse [N s], work of the sample [J], usable share of the
    friction by the tracks' motors [-], and sum of the normal impulses [N s].
    """
    numbers = carray(arbiter, (_NUMBERS,), dtype=np.float64)
    speed, largest, _, share, _ = carray(belt, (5,), dtype=np.float64)
    # A belt that its load holds slips as one that lacks grip.
    if share < 1.0:
        numbers[FRICTION] *= share
    # If the ground is the first shape, normal and surface velocity both change sign.
    numbers[SURFACE] = -speed * numbers[NORMAL + 1]
    numbers[SURFACE + 1] = speed * numbers[NORMAL]
    # Impulses that are cached in a wedge must not grow without bounds.
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
        numbers[2] += abs(numbers[0] * contacts[first + TANGENT_IMPULSE])
        numbers[4] += contacts[first + NORMAL_IMPULSE]


_is_over = cached(njit)(is_over)


class _Access(NamedTuple):
    """Addresses and memory through which compiled code reads and writes the robot's bodies."""

    chassis: int
    front: int
    rear: int
    reading: int  # pymunk's request to append the states of a body
    read: NDArray[np.int32]  # number of values in ``states`` that are filled, (1,)
    states: FloatArray
    """States of chassis, front and rear flippers in their order, flat; see ``STATE``."""
    writing: int  # pymunk's request to take the velocities of a body
    written: NDArray[np.int32]  # number of values in ``velocities`` that are taken, (1,)
    velocities: FloatArray  # velocity (x, z) [m/s] and angular velocity [rad/s] of the bodies, flat


@cached(njit)
def _read_states(access: tuple[Any, ...]) -> None:
    bodies = _Access(*access)
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
    access: tuple[Any, ...],
    inertia: FloatArray,
    belt: FloatArray,
    budget: tuple[float, ...],
    grip: float,
    gears: NDArray[np.uintp],
    spent: FloatArray,
    poses: FloatArray,
    limits: tuple[float, ...],
) -> int:
    bodies = _Access(*access)
    states, (gravity, servos, belts, tolerance, ahead, above) = bodies.states, budget
    stop, finish, top, half, slope, end, level = limits
    # Energy and flipper angles before the first sample
    _read_states(access)
    energy = kinetic_energy(states, inertia)
    energy += potential_energy(states, inertia, gravity, ahead, above)
    turned, impulses = np.zeros(len(gears)), np.zeros(len(gears))
    for gear in range(len(gears)):
        turned[gear] = states[STATE * (gear + 1) + 2] - states[2]
    for sample in range(len(poses)):
        # Substeps of the sample, each with the friction that the normal impulses of the last one
        # allow
        belt[2] = 0.0
        impulses[:] = 0.0
        for _ in range(substeps):
            belt[3] = grip / belt[4] if belt[4] > grip else 1.0
            belt[4] = 0.0
            _step(space, substep)
            for gear in range(len(gears)):
                impulses[gear] += _impulse(gears[gear])
        # The servos' work, as mean torque times turn of each flipper
        _read_states(access)
        for gear in range(len(gears)):
            before, turned[gear] = turned[gear], states[STATE * (gear + 1) + 2] - states[2]
            spent[0] += impulses[gear] / (substep * substeps) * abs(turned[gear] - before)
        # The gain of energy, bounded by what servos and belts can have supplied
        kinetic = kinetic_energy(states, inertia)
        potential = potential_energy(states, inertia, gravity, ahead, above)
        supplied = servos + min(belt[2], belts) + tolerance
        excess = kinetic + potential - (energy + supplied)
        energy = kinetic + potential
        if excess > 0.0:
            _slow_down(bodies, slowdown(kinetic, excess))
            energy -= min(excess, kinetic)
        # The pose; both flippers' angles are positive above the chassis.
        x, z, angle = states[0], states[1], states[2]
        poses[sample, 0], poses[sample, 1], poses[sample, 2] = x, z, angle
        poses[sample, 3] = states[STATE + 2] - angle
        poses[sample, 4] = angle - states[2 * STATE + 2]
        if _is_over(x, z, angle, stop, finish, top, half, slope, end, level):
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
        # The callbacks read and write the numbers of the belts through this memory.
        handler = lib.cpSpaceAddCollisionHandler(space._space, TRACK, GROUND)
        numbers = ffi.new("double[5]", [belt.speed, belt.largest, 0.0, 1.0, 0.0])
        handler.userData = numbers
        handler.preSolveFunc = ffi.cast("cpCollisionPreSolveFunc", _belt.address)
        handler.postSolveFunc = ffi.cast("cpCollisionPostSolveFunc", _work.address)
        # The bodies are read and written through requests of pymunk's batch functions.
        velocity = lib.VELOCITY | lib.ANGULAR_VELOCITY
        read = _Batch(lib.POSITION | lib.ANGLE | velocity, 3 * STATE)
        write = _Batch(velocity, 9)
        chassis, front, rear = (address(body._body) for body in bodies)
        access = _Access(chassis, front, rear, *read.parts, *write.parts)
        self._memory = space, bodies, gears, numbers, read, write  # must live as long as the loop
        self._belt = np.frombuffer(ffi.buffer(numbers))
        self._access, self._states = tuple(access), access.states
        self._spent = np.zeros(1)
        # No call changes these arguments; the arrays share their memory with the callbacks. A call
        # passes a plain tuple on faster than a named one.
        self._arguments = (
            address(space._space),
            substep,
            substeps,
            self._access,
            np.array([[body.mass, body.moment] for body in bodies]),
            self._belt,
            tuple(budget),
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

    def states(self) -> FloatArray:
        """Return the states of chassis, front and rear flippers now, flat; see ``STATE``."""
        _read_states(self._access)
        return self._states[: 3 * STATE]

    def run_belts(self, speed: float) -> None:
        """Set the speed of the belts' surface along the outline [m/s]."""
        self._belt[0] = speed

    def forget(self) -> None:
        """Forget the contacts of the last substep, before a run from another state."""
        self._belt[4] = 0.0

    def run(self, poses: FloatArray, limits: Limits) -> int:
        """Fill the rows of ``poses``, one per sample; return the number of filled rows.

        The run stops after the sample at which a limit is reached. ``poses`` is (S, 5): x [m],
        z [m], pitch, front and rear flipper angle [rad].
        """
        return int(_run(*self._arguments, poses, tuple(limits)))


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
    layout: dict[str, Any] = {}
    answers: dict[str, Any] = {}

    def read(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        normal, struct = arbiter.normal, arbiter._arbiter
        # No contact has such a velocity by default, so that a wrong offset shows.
        arbiter.surface_velocity = (-0.5 * normal.y, 0.5 * normal.x)
        doubles = np.frombuffer(ffi.buffer(struct, ffi.sizeof("cpArbiter")), np.float64)
        answers.update(
            normal=tuple(normal),
            surface_velocity=tuple(arbiter.surface_velocity),
            friction=arbiter.friction,
            contacts=len(arbiter.contact_point_set.points),
            address=address(struct.contacts),
        )
        layout.update(
            normal=tuple(doubles[NORMAL : NORMAL + 2].tolist()),
            surface_velocity=tuple(doubles[SURFACE : SURFACE + 2].tolist()),
            friction=float(doubles[FRICTION]),
            contacts=int(doubles.view(np.int32)[COUNT]),
            address=int(doubles.view(np.uintp)[CONTACTS]),
        )

    def pressed(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        size = layout["contacts"] * CONTACT * _DOUBLE
        if layout != answers or not size:
            return  # the address may be wrong
        contacts = np.frombuffer(ffi.buffer(ffi.cast("char *", layout["address"]), size))
        sums = [contacts[at::CONTACT].sum() for at in (NORMAL_IMPULSE, TANGENT_IMPULSE)]
        x, y = answers["normal"]
        layout["impulse"] = np.round(sums @ np.array([[x, y], [-y, x]]), 9).tolist()
        # Pymunk returns the impulse on the other body.
        answers["impulse"] = np.round(-np.array(arbiter.total_impulse), 9).tolist()

    # The body slides on a slope, so that normal, friction and both impulses differ from 0.
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
    if layout != answers:
        raise ConfigError(
            f"sim=planar cannot be used with pymunk {pymunk.version}: its contact has {layout} "
            f"where pymunk itself has {answers}; install another pymunk"
        )
