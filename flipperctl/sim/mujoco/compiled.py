"""The engine's inner loop as machine code: servos, steered belts, and the pose of each sample.

It steps MuJoCo through its C function, and reads and writes arrays that share MuJoCo's memory. The
tests compute the same numbers through MuJoCo's Python functions.
"""

from __future__ import annotations

import ctypes
import math
import sys
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit, types

from flipperctl.api import FloatArray
from flipperctl.api.engines import is_over
from flipperctl.api.jit import c_function, cached

HINGES = slice(7, 11)
"""Places of the flippers' angles in ``qpos``, after those of the free joint."""
SERVO_RATE = 25.0
"""Velocity that a servo demands for each rad of its angle's error [1/s]."""
_LARGEST_STEER = 0.5
"""Largest difference of a belt's speed from the robot's by steering, as a fraction [-]."""
_STEER_AHEAD = 1.0  # steering aims at the middle of the ground this far ahead [m]

_library = ctypes.CDLL(sys.modules[mujoco.mj_step.__module__].__file__)
_address = ctypes.cast(_library.mj_step, ctypes.c_void_p).value
_step = c_function("mj_step", _address or 0, types.void(types.uintp, types.uintp))
_is_over = cached(njit)(is_over)

Axis = tuple[float, float, float]


@cached(njit)
def ahead(pose: FloatArray) -> Axis:
    """Return the chassis' x axis in world, by ``qpos``; after ``mj_step``, ``xmat`` is old."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    return 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)


@cached(njit)
def left(pose: FloatArray) -> Axis:
    """Return the chassis' y axis in world, by ``qpos``."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    return 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)


@cached(njit)
def pitch_of(pose: FloatArray, up: Axis) -> float:
    """Return the angle of the chassis' x axis above the horizontal [rad]."""
    x, y, z = ahead(pose)
    rise = y * up[1] + z * up[2]
    return math.atan2(rise, math.copysign(math.sqrt(max(0.0, 1.0 - rise * rise)), x))


@cached(njit)
def roll_of(pose: FloatArray, up: Axis) -> float:
    """Return the angle of the chassis' y axis, to the left, above the horizontal [rad]."""
    _, y, z = left(pose)
    return math.asin(min(1.0, max(-1.0, y * up[1] + z * up[2])))


@cached(njit)
def yaw_of(pose: FloatArray) -> float:
    """Return the heading of the chassis from the x axis, to the left positive [rad]."""
    x, y, _ = ahead(pose)
    return math.atan2(y, x)


@cached(njit)
def faster(pose: FloatArray, gain: float) -> float:
    """Return by which fraction the left belts run faster than the robot's speed."""
    steer = gain * (yaw_of(pose) + pose[1] / _STEER_AHEAD)
    fraction: float = min(_LARGEST_STEER, max(-_LARGEST_STEER, steer))
    return fraction


class Scene(NamedTuple):
    """Addresses, shared memory and constants of one robot on one ground."""

    model: int
    data: int
    pose: FloatArray  # ``qpos``, (11,): of the free joint [m] and [-], then of the hinges [rad]
    velocities: FloatArray  # ``ctrl``, demanded by the servos, (4,) [rad/s]
    torques: FloatArray  # ``actuator_force``, (4,) [N m]
    moving: FloatArray  # ``geom_surfacevel``, (G, 6)
    belts: FloatArray  # (G, 6) of it at the robot's speed
    sides: FloatArray  # (G,) 1 on the left, -1 on the right, 0 for the ground
    substeps: int  # of each sample
    rate: float  # largest speed of a flipper [rad/s]
    gain: float  # of the heading [1/rad]
    up: Axis  # against gravity
    half_width: float  # of the ground [m]
    roll_limit: float  # [rad]


@cached(njit)
def has_fallen(s: Scene) -> bool:
    """Return whether the robot rolled over sideways or left the ground at its side."""
    fell: bool = abs(s.pose[1]) > s.half_width or abs(roll_of(s.pose, s.up)) >= s.roll_limit
    return fell


@cached(njit)
def run(
    s: Scene,
    targets: FloatArray,
    share: float,
    sums: FloatArray,
    poses: FloatArray,
    limits: tuple[float, ...],
) -> tuple[int, bool]:
    """Fill the rows of ``poses``, one per sample, until a limit is reached or the robot has fallen.

    ``poses`` is (S, 7): x [m], z [m], pitch and the hinges' angles [rad]. ``targets``: of the
    hinges, (4,) [rad]. ``share``: of the robot's speed at which the belts run [-]. ``sums``:
    the servos' work [J] and the roll's changes [rad], to which the run adds, (2,). Return the
    number of filled rows, and whether the run is over.
    """
    angles, turned, torques = s.pose[HINGES], np.empty(4), np.empty(4)
    stop, finish, top, half, slope, end, level = limits
    roll = roll_of(s.pose, s.up)
    for sample in range(len(poses)):
        # The velocities that the servos demand, and the speeds of the belts
        for i in range(4):
            velocity = SERVO_RATE * (targets[i] - angles[i])
            s.velocities[i] = min(max(velocity, -s.rate), s.rate)
        if s.gain:
            steer = faster(s.pose, s.gain)
            for part in range(len(s.sides)):
                s.moving[part] = share * (s.belts[part] * (1.0 + steer * s.sides[part]))
        # The servos' work, as mean torque times turn of each flipper, since torques chatter
        turned[:] = angles
        torques[:] = 0.0
        for _ in range(s.substeps):
            _step(s.model, s.data)
            torques += s.torques
        sums[0] += np.abs(torques / s.substeps * (angles - turned)).sum()
        earlier, roll = roll, roll_of(s.pose, s.up)
        sums[1] += abs(roll - earlier)
        # The pose of the chassis and of all flippers
        x, z, pitch = s.pose[0], s.pose[2], pitch_of(s.pose, s.up)
        poses[sample, 0], poses[sample, 1], poses[sample, 2] = x, z, pitch
        poses[sample, 3:] = angles
        if has_fallen(s) or _is_over(x, z, pitch, stop, finish, top, half, slope, end, level):
            return sample + 1, True
    return len(poses), False
