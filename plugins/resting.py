"""How a robot rests on the ground by contact geometry alone, for controllers that predict poses.

In: points of the ground, places of the chassis centre and flipper angles. Out: pitches, heights and
stability margins.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, RobotGeometry

from .posture import compiled, tipping_rise

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
    ahead = _parts(robot.hinge_offset, robot.flipper_axle, tuple(front), 1.0)
    behind = _parts(robot.hinge_offset, robot.flipper_axle, tuple(rear), -1.0)
    ahead_height, behind_height = (_heights(ground, places, parts) for parts in (ahead, behind))
    above = ahead_height[..., :, None] - behind_height[..., None, :]  # (K, T, A, B)
    lowest = np.maximum(above, 0.0) + behind_height[..., None, :]
    index = lowest.argmin(axis=1, keepdims=True)  # of the pitch, (K, 1, A, B)
    # The pitch of equal heights lies between the lowest one and the next on the side that is free.
    here = np.take_along_axis(above, index, axis=1)
    toward = np.where(here > 0, 1, -1)
    neighbour = np.clip(index + toward, 0, len(_PITCHES) - 1)
    there = np.take_along_axis(above, neighbour, axis=1)
    between = np.divide(here, here - there, out=np.zeros_like(here), where=here * there < 0)
    pitch = _PITCHES[index] + between * (_PITCHES[neighbour] - _PITCHES[index])
    # The robot tips over the lower barrier, and hooks at the steeper slope.
    a, b = np.arange(len(front))[:, None], np.arange(len(rear))
    touching = (
        _contact(ground, robot, places, parts[:, index[:, 0], angle], sign)
        for parts, angle, sign in ((ahead, a, 1.0), (behind, b, -1.0))
    )
    barriers, slopes = zip(*touching, strict=True)
    height = np.take_along_axis(lowest, index, axis=1)
    return Rest(pitch[:, 0], height[:, 0], np.minimum(*barriers), np.maximum(*slopes))


@lru_cache(maxsize=8)
def _parts(hinge: float, axle: float, angles: tuple[float, ...], sign: float) -> FloatArray:
    """Return (x, z) of the parts ahead of the chassis centre (``sign`` 1) or behind it (-1).

    (2, T, A, S), for each pitch and each of the ``angles`` [rad], from the chassis centre [m].
    ``hinge``: distance of the hinge from the centre, ``axle``: length of the flipper's axis [m].
    """

    def axis(length: float, angle: FloatArray, along: FloatArray) -> FloatArray:
        return sign * length * np.stack([np.cos(angle), np.sin(angle)])[..., None] * along

    # Points on the axes of chassis and flipper
    pitch = np.broadcast_to(_PITCHES[:, None], (len(_PITCHES), len(angles)))
    chassis = axis(hinge, pitch, _CHASSIS)
    flipper = axis(axle, pitch + sign * np.array(angles), _FLIPPER) + chassis[..., -1:]
    return np.concatenate([chassis, flipper], axis=-1)


def _heights(ground: FloatArray, places: FloatArray, parts: FloatArray) -> FloatArray:
    """Return the height of the chassis centre at which one of ``_parts`` touches, (K, T, A) [m]."""
    x, z, _ = ground
    heights = np.empty((len(places), *parts.shape[1:3]))
    compiled(_fill)(heights, x, z, np.diff(z) / np.diff(x), places, *parts)
    return heights


def _fill(
    heights: FloatArray,
    x: FloatArray,
    z: FloatArray,
    slopes: FloatArray,
    places: FloatArray,
    parts_x: FloatArray,
    parts_z: FloatArray,
) -> None:
    """Fill in the largest difference of the ground's height, as np.interp has it, and a part's z.

    ``slopes`` are those between the ground's points, whose ``x`` are evenly spaced and reach beyond
    all parts.
    """
    per_metre = 1 / (x[1] - x[0])
    for place, pitch, angle in np.ndindex(heights.shape):
        highest = -math.inf
        for part in range(parts_x.shape[2]):
            at = places[place] + parts_x[pitch, angle, part]
            # The spacing is rounded, so that the point before may be a neighbour of this one.
            i = int((at - x[0]) * per_metre)
            if x[i] > at:
                i -= 1
            elif x[i + 1] <= at:
                i += 1
            height = slopes[i] * (at - x[i]) + z[i]
            highest = max(highest, height - parts_z[pitch, angle, part])
        heights[place, pitch, angle] = highest


def _contact(
    ground: FloatArray, robot: RobotGeometry, places: FloatArray, parts: FloatArray, sign: float
) -> tuple[FloatArray, FloatArray]:
    """Return what the parts of one side touch at rest, each (K, A, B), by their (x, z) there [m].

    The rise of the chassis centre until the robot tips over the outermost contact [m], and the
    slope of the inflated ground at the first one [rad].
    """
    x, z = parts  # (K, A, B, S)
    at = places[:, None, None, None] + x
    heights = np.interp(at, ground[0], ground[1]) - z
    # The part that needs the highest centre touches first.
    first = heights.argmax(axis=-1)[..., None]
    height = np.take_along_axis(heights, first, axis=-1)
    slope = np.interp(np.take_along_axis(at, first, axis=-1), ground[0], ground[2])
    # The robot would tip over the outermost part that touches.
    outward = np.where(heights >= height - _TOUCH, sign * x, -np.inf)
    outermost = outward.argmax(axis=-1)[..., None]
    across = np.maximum(0.0, np.take_along_axis(outward, outermost, axis=-1))
    above = robot.track_radius - np.take_along_axis(z, outermost, axis=-1)
    return tipping_rise(across, above)[..., 0], slope[..., 0]


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
