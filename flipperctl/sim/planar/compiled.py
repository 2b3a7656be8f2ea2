"""The engine's inner loop as machine code, without Python between the decisions of a robot.

Chipmunk is stepped through its C function, and a compiled callback sets the belt velocity of every
contact. ``plain`` computes the same numbers through pymunk's public interface.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding
import numpy as np
import pymunk
from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]  # carray
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from flipperctl.api import FloatArray, Limits
from flipperctl.api.engines import is_over
from flipperctl.sim.jit import cached
from flipperctl.sim.planar.plain import GROUND, TRACK, Belt, Bodies

_DOUBLE = 8  # bytes


def _double(struct: str, *path: str) -> int:
    """Return the offset of a number in one of Chipmunk's structs, in doubles."""
    return int(ffi.offsetof(struct, *path)) // _DOUBLE


_NORMAL = _double("cpArbiter", "n", "x")
_SURFACE = _double("cpArbiter", "surface_vr", "x")
_CONTACTS = _double("cpArbiter", "contacts")
_COUNT = int(ffi.offsetof("cpArbiter", "count")) // 4
_PRESS = _double("struct cpContact", "jnAcc")
_DRIVE = _double("struct cpContact", "jtAcc")
_CONTACT = int(ffi.sizeof("struct cpContact")) // _DOUBLE


def _address(pointer: Any) -> int:
    return int(ffi.cast("uintptr_t", pointer))


def _c_function(name: str, signature: Any) -> Any:
    """Return a function of pymunk's C library for calls from compiled code."""
    llvmlite.binding.add_symbol(name, _address(ffi.addressof(lib, name)))
    return types.ExternalFunction(name, signature)


_step = _c_function("cpSpaceStep", types.void(types.uintp, types.float64))
_read = _c_function("pmSpaceBodyGetIteratorFuncBatched", types.void(types.uintp, types.uintp))


def _to_pointer(typing_context: Any, address: Any) -> Any:
    """Compile the cast of an address to a pointer that ``carray`` takes."""

    def cast(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.uintp), cast


_pointer: Any = intrinsic(_to_pointer)


@cached(cfunc, types.void(types.voidptr, types.voidptr, types.voidptr))
def _belt(arbiter: Any, space: Any, belt: Any) -> None:
    """Set a contact's belt velocity and bound its remembered impulses, before it is solved.

    ``belt``: speed [m/s] and largest remembered impulse [N s].
    """
    numbers = carray(arbiter, (_NORMAL + 2,), dtype=np.float64)
    speed, largest = carray(belt, (2,), dtype=np.float64)
    # If the ground is the first shape, normal and surface velocity both change sign.
    numbers[_SURFACE] = -speed * numbers[_NORMAL + 1]
    numbers[_SURFACE + 1] = speed * numbers[_NORMAL]
    count = carray(arbiter, (_COUNT + 1,), dtype=np.int32)[_COUNT]
    address = carray(arbiter, (_CONTACTS + 1,), dtype=np.uintp)[_CONTACTS]
    contacts = carray(_pointer(address), (count * _CONTACT,), dtype=np.float64)
    for first in range(0, count * _CONTACT, _CONTACT):
        press = contacts[first + _PRESS]
        if press > largest:
            contacts[first + _PRESS] = largest
            contacts[first + _DRIVE] *= largest / press


_is_over = cached(njit)(is_over)


@cached(njit)
def _run(
    space: int,
    substep: float,
    substeps: int,
    chassis: int,
    front: int,
    rear: int,
    request: int,
    filled: NDArray[np.int32],
    pose: FloatArray,
    poses: FloatArray,
    angle_limit: float,
    x_limit: float,
    top: float,
    half: float,
) -> int:
    for sample in range(len(poses)):
        for _ in range(substeps):
            _step(space, substep)
        filled[0] = 0  # the reader appends
        _read(chassis, request)
        _read(front, request)
        _read(rear, request)
        x, z, angle = pose[0], pose[1], pose[2]
        poses[sample, 0], poses[sample, 1], poses[sample, 2] = x, z, angle
        poses[sample, 3], poses[sample, 4] = pose[5] - angle, angle - pose[8]
        if _is_over(x, z, angle, angle_limit, x_limit, top, half):
            return sample + 1
    return len(poses)


class CompiledLoop:
    """Steps a space and samples the pose of its robot, equal to ``PlainLoop`` bit for bit."""

    def __init__(
        self, space: pymunk.Space, bodies: Bodies, belt: Belt, substep: float, substeps: int
    ) -> None:
        handler = lib.cpSpaceAddCollisionHandler(space._space, TRACK, GROUND)
        numbers = ffi.new("double[2]", belt)
        handler.userData = numbers
        handler.preSolveFunc = ffi.cast("cpCollisionPreSolveFunc", _belt.address)
        # pymunk's batch reader puts position and angle into an array: x, y, angle of each body.
        pose = ffi.new("double[16]")  # larger than needed, so that it is never reallocated
        array = ffi.new("pmFloatArray *", {"num": 0, "max": 16, "arr": pose})
        fields = lib.POSITION | lib.ANGLE
        request = ffi.new("pmBatchedData *", {"fields": fields, "floatArray": array})
        self._memory = (
            space,
            bodies,
            numbers,
            pose,
            array,
            request,
        )  # must live as long as the loop
        filled = np.frombuffer(ffi.buffer(ffi.addressof(array, "num")), np.int32)
        chassis, front, rear = (_address(body._body) for body in bodies)
        self._arguments = (
            *(_address(space._space), substep, substeps, chassis, front, rear, _address(request)),
            *(filled, np.frombuffer(ffi.buffer(pose))),
        )

    def run(self, poses: FloatArray, limits: Limits) -> int:
        """Fill the rows of ``poses``; see ``PlainLoop.run``."""
        return int(_run(*self._arguments, poses, *limits))


@cached(njit)
def _steps(space: int, substep: float, count: int) -> None:
    for _ in range(count):
        _step(space, substep)


def step_alone(space: pymunk.Space, substep: float, count: int) -> None:
    """Step a space ``count`` times and do nothing else, the upper bound of the speed of ``run``."""
    _steps(_address(space._space), substep, count)
