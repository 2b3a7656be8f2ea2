"""How a robot rests on the ground by contact geometry alone, for controllers that predict poses.

In: points of the ground, places of the chassis centre and flipper angles. Out: pitches, heights and
stability margins.
"""

import math
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, RobotGeometry

from .posture import tipping_rise

_CELL = 0.01
"""Distance between the heights of the ground [m]."""
_PITCHES = np.radians(np.arange(-60.0, 60.1, 1.5))
"""Pitches among which the rest is sought, (T,) [rad]."""
_CHASSIS, _FLIPPER = np.linspace(0.0, 1.0, 5), np.linspace(0.125, 1.0, 8)
"""Where half of the chassis and a flipper may touch, as fractions of their axes, (S,) in all."""
_TOUCH = 0.01
"""Largest gap to the ground that counts as contact for the stability margin [m]."""


class Rest(NamedTuple):
    """A robot at rest, each (K, A, B): place, front angle, rear angle."""

    pitch: FloatArray
    """[rad]"""
    height: FloatArray
    """Height of the chassis centre in the frame of the ground's points [m]."""
    margin: FloatArray
    """Energy stability margin: rise of the chassis centre until the robot tips over [m]."""
    slope: FloatArray
    """Largest slope of the ground, inflated by the track radius, at a contact [rad]."""


def rest(
    points: FloatArray,
    robot: RobotGeometry,
    places: FloatArray,
    front: FloatArray,
    rear: FloatArray,
) -> Rest:
    """Return how the robot rests on ``points``, (P, 2) [m], x never decreasing.

    ``places``: x of the chassis centre, (K,) [m]; ``front``, ``rear``: flipper angles in frame R,
    (A,) and (B,) [rad]. Beyond the points, and without any, the ground is level.

    At a given pitch the robot comes down until a part touches on one side of its centre. The weight
    then turns the other side down until that touches, too: there the centre is lowest. The weight
    of the flippers and a load are left out.
    """
    reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius
    # Parts on each side of the centre hold it up, and it cannot be lower than either allows.
    ground = _inflated(points, robot.track_radius, places[0] - reach, places[-1] + reach)
    ahead = _contacts(ground, robot, places, front, 1.0)
    behind = _contacts(ground, robot, places, rear, -1.0)
    above = ahead.height[..., :, None] - behind.height[..., None, :]  # (K, T, A, B)
    lowest = np.maximum(above, 0.0) + behind.height[..., None, :]
    index = lowest.argmin(axis=1, keepdims=True)  # of the pitch, (K, 1, A, B)
    # The pitch of equal heights lies between the lowest one and the next on the side that is free.
    here = np.take_along_axis(above, index, axis=1)
    toward = np.where(here > 0, 1, -1)
    neighbour = np.clip(index + toward, 0, len(_PITCHES) - 1)
    there = np.take_along_axis(above, neighbour, axis=1)
    between = np.divide(here, here - there, out=np.zeros_like(here), where=here * there < 0)
    pitch = _PITCHES[index] + between * (_PITCHES[neighbour] - _PITCHES[index])

    def at_rest(values: FloatArray) -> FloatArray:
        return np.take_along_axis(values, index, axis=1)[:, 0]

    # The robot tips over the lower barrier, and hooks at the steeper slope.
    barriers = at_rest(ahead.barrier[..., :, None]), at_rest(behind.barrier[..., None, :])
    slopes = at_rest(ahead.slope[..., :, None]), at_rest(behind.slope[..., None, :])
    return Rest(pitch[:, 0], at_rest(lowest), np.minimum(*barriers), np.maximum(*slopes))


class _Contacts(NamedTuple):
    """The parts on one side of the chassis centre, each (K, T, A): place, pitch, angle."""

    height: FloatArray
    """Height of the chassis centre at which they touch the ground [m]."""
    barrier: FloatArray
    """Rise of the chassis centre until the robot tips over the outermost contact [m]."""
    slope: FloatArray
    """Slope of the inflated ground at the first contact [rad]."""


def _contacts(
    ground: FloatArray, robot: RobotGeometry, places: FloatArray, angles: FloatArray, sign: float
) -> _Contacts:
    """Return the contacts ahead of the chassis centre (``sign`` 1) or behind it (-1)."""

    def axis(length: float, angle: FloatArray, along: FloatArray) -> FloatArray:
        return sign * length * np.stack([np.cos(angle), np.sin(angle)])[..., None] * along

    # Points on the axes of chassis and flipper, for each pitch and each angle
    pitch = np.broadcast_to(_PITCHES[:, None], (len(_PITCHES), len(angles)))
    chassis = axis(robot.hinge_offset, pitch, _CHASSIS)  # (2, T, A, S)
    flipper = axis(robot.flipper_axle, pitch + sign * angles, _FLIPPER) + chassis[..., -1:]
    x, z = np.concatenate([chassis, flipper], axis=-1)  # (T, A, S), from the chassis centre
    at = places[:, None, None, None] + x  # (K, T, A, S)
    heights = np.interp(at, ground[0], ground[1]) - z
    # The part that needs the highest centre touches first.
    first = heights.argmax(axis=-1)[..., None]
    height = np.take_along_axis(heights, first, axis=-1)
    slope = np.interp(np.take_along_axis(at, first, axis=-1), ground[0], ground[2])
    # The robot would tip over the outermost part that touches.
    outward = np.where(heights >= height - _TOUCH, sign * x, -np.inf)
    outermost = outward.argmax(axis=-1)[..., None]
    across = np.maximum(0.0, np.take_along_axis(outward, outermost, axis=-1))
    above = robot.track_radius - np.take_along_axis(
        np.broadcast_to(z, at.shape), outermost, axis=-1
    )
    rise = tipping_rise(across, above)
    return _Contacts(height[..., 0], rise[..., 0], slope[..., 0])


def _inflated(points: FloatArray, radius: float, low: float, high: float) -> FloatArray:
    """Return x, height [m] and slope [rad] of the ground inflated by ``radius``, (3, C)."""
    x = np.arange(low, high + _CELL, _CELL)
    n = math.floor(radius / _CELL)
    across = _CELL * np.arange(-n, n + 1)
    wide = np.concatenate([x[0] + across[:n], x, x[-1] + across[n + 1 :]])
    z = np.interp(wide, *points.T) if len(points) else np.full(len(wide), -radius)
    # The circle's centre is as high as the highest ground below it demands.
    windows = np.lib.stride_tricks.sliding_window_view(z, 2 * n + 1)
    z = (windows + np.sqrt(radius**2 - across**2)).max(axis=-1)
    return np.stack([x, z, np.arctan(np.gradient(z, _CELL))])
