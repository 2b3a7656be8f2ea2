"""A controller that plans by contact geometry alone, over the ground that the robot perceives.

In: a perception. Out: an action. ``rest`` computes how the robot rests on the ground at places
ahead, with each pair of flipper angles. ``Geometric`` plans the angles by dynamic programming.
"""

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from flipperctl.api import (
    ACTIONS,
    Controller,
    FloatArray,
    Perception,
    RobotGeometry,
    action_index,
    controller,
)

from ..posture import tipping_rise, with_masses

_TURNS = sorted(ACTIONS, key=lambda turns: abs(turns[0]) + abs(turns[1]))
"""Turns (front, rear) of the actions; of equally good ones the first is taken."""
_STEPS = 4
"""Largest number of angle steps each way from 0 among the planned angles [-]."""
_STEEP = math.atan(0.75)
"""Slope of the chassis centre's path, with the flippers held, from which it costs [rad]."""
_MARGIN_COST = 5.0
"""Cost of each metre that the stability margin lacks, as pitch [rad/m]."""

_CELL = 0.01
"""Distance between the heights of the ground [m]."""
_PITCHES = np.radians(np.arange(-60.0, 60.1, 1.5))
"""Pitches among which the rest is sought, (T,) [rad]."""
_CHASSIS, _FLIPPER = np.linspace(0.0, 1.0, 5), np.linspace(0.125, 1.0, 8)
"""Where half of the chassis and a flipper may touch, as fractions of their axes, (S,) in all."""
_TOUCH = 0.01
"""Largest gap to the ground that counts as contact for the stability margin [m]."""


@controller("geometric")
class Geometric(Controller):
    """Plan the flippers for the least pitch change, from where the robot would rest on the ground.

    Li et al. (2013) and Chen et al. (Journal of Field Robotics, 2023) predict the pose from contact
    geometry, without forces, and Chen et al. plan the flippers by dynamic programming. Here a plan
    has a place for each decision ahead, at the speed of the belts. Each pair turns by one step or
    none from place to place. Only the first turns are taken. A plan ends with the change to the
    pitch that level flippers would give at its last place.
    """

    horizon: int = Field(8, ge=1, le=12, description="decisions that a plan looks ahead [-]")
    turn: float = Field(
        0.01, ge=0, le=1, description="cost of turning a pair by one angle step, as pitch [rad]"
    )
    clearance: float = Field(
        0.2,
        ge=0,
        le=5,
        description="cost of each metre by which the flippers lift the chassis, as pitch [rad/m]",
    )
    margin: float = Field(
        0.05, ge=0, le=0.3, description="stability margin below which a pose costs; 0: off [m]"
    )
    climb: float = Field(
        2.0,
        ge=0,
        le=20,
        description="cost of each radian by which the way to the next place is steeper than 37° "
        "with the flippers held, where belts slip [-]",
    )

    def act(self, p: Perception) -> int:
        """Return the first turns of the best plan."""
        robot = with_masses(p.robot)
        step = max(robot.angle_step, robot.angle_limit / _STEPS)
        count = math.floor(robot.angle_limit / step + 1e-9)
        angles = step * np.arange(-count, count + 1.0)  # (A,) [rad]
        places = robot.track_speed * robot.decision_period * np.arange(self.horizon + 1.0)
        poses = rest(p.points, robot, places, angles)
        front, rear = (int(np.abs(angles - angle).argmin()) for angle in (p.front, p.rear))
        costs = self._costs(poses, places[1])
        poses.pitch[0] = p.pitch
        best = self._options(poses.pitch, costs)[:, front, rear].argmin()
        return action_index(*_TURNS[best])

    def _costs(self, poses: "Rest", stride: float) -> FloatArray:
        """Return the costs of the poses at the K places ahead, ``stride`` [m] apart, (K, A, A)."""
        lift = (poses.height - poses.height.min(axis=(1, 2), keepdims=True))[1:]
        lacking = np.maximum(0.0, self.margin - poses.margin)[1:]
        slope = np.arctan(np.diff(poses.height, axis=0) / stride)
        steep = np.maximum(0.0, slope - _STEEP)
        costs: FloatArray = self.clearance * lift + _MARGIN_COST * lacking + self.climb * steep
        return costs

    def _options(self, pitch: FloatArray, costs: FloatArray) -> FloatArray:
        """Return the cost of the best plan that begins with each of ``_TURNS``, (9, A, A) [rad].

        ``pitch``: that of each place with each front and rear angle, the present place first,
        (K + 1, A, A) [rad]; ``costs``: those of the poses at the places ahead, (K, A, A) [rad].
        """
        count = pitch.shape[1]
        to_go = np.abs(pitch[-1] - pitch[-1, count // 2, count // 2])  # from each pair of angles
        options = np.empty((len(_TURNS), count, count))
        for at in range(len(costs) - 1, -1, -1):
            there = np.pad(pitch[at + 1], 1)
            then = np.pad(costs[at] + to_go, 1, constant_values=math.inf)
            for option, (i, j) in zip(options, _TURNS, strict=True):
                window = np.s_[1 + i : 1 + i + count, 1 + j : 1 + j + count]
                turned = self.turn * (abs(i) + abs(j))
                option[:] = then[window] + np.abs(there[window] - pitch[at]) + turned
            to_go = options.min(axis=0)
        return options


class Rest(NamedTuple):
    """A robot at rest, each (K, A, A): place, front angle, rear angle."""

    pitch: FloatArray
    """[rad]"""
    height: FloatArray
    """Height of the chassis centre in the frame of the ground's points [m]."""
    margin: FloatArray
    """Energy stability margin: rise of the chassis centre until the robot tips over [m]."""


def rest(points: FloatArray, robot: RobotGeometry, places: FloatArray, angles: FloatArray) -> Rest:
    """Return how the robot rests on ``points``, (P, 2) [m], x never decreasing.

    ``places``: x of the chassis centre, (K,) [m]; ``angles``: those of either pair, (A,) [rad].
    Beyond the points, and without any, the ground is level.

    At a given pitch the robot comes down until a part touches on one side of its centre. The weight
    then turns the other side down until that touches, too: there the centre is lowest. The weight
    of the flippers and a load are left out.
    """
    reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius
    ground = _inflated(points, robot.track_radius, places[0] - reach, places[-1] + reach)
    front, rear = (_contacts(ground, robot, places, angles, sign) for sign in (1.0, -1.0))
    above = front.height[..., :, None] - rear.height[..., None, :]  # (K, T, A, A)
    lowest = np.maximum(above, 0.0) + rear.height[..., None, :]
    found = lowest.argmin(axis=1, keepdims=True)  # (K, 1, A, A)
    # The pitch of equal heights lies between the lowest one and the next on the side that is free.
    here = np.take_along_axis(above, found, axis=1)
    toward = np.where(here > 0, 1, -1)
    beside = np.clip(found + toward, 0, len(_PITCHES) - 1)
    there = np.take_along_axis(above, beside, axis=1)
    between = np.divide(here, here - there, out=np.zeros_like(here), where=here * there < 0)
    pitch = _PITCHES[found] + between * (_PITCHES[beside] - _PITCHES[found])

    def at_rest(values: FloatArray) -> FloatArray:
        return np.take_along_axis(values, found, axis=1)[:, 0]

    barriers = at_rest(front.barrier[..., :, None]), at_rest(rear.barrier[..., None, :])
    return Rest(pitch[:, 0], at_rest(lowest), np.minimum(*barriers))


class _Contacts(NamedTuple):
    """The parts on one side of the chassis centre, each (K, T, A): place, pitch, angle."""

    height: FloatArray
    """Height of the chassis centre at which they touch the ground [m]."""
    barrier: FloatArray
    """Rise of the chassis centre until the robot tips over the outermost contact [m]."""


def _contacts(
    ground: FloatArray, robot: RobotGeometry, places: FloatArray, angles: FloatArray, sign: float
) -> _Contacts:
    """Return the contacts ahead of the chassis centre (``sign`` 1) or behind it (-1)."""

    def axis(length: float, angle: FloatArray, along: FloatArray) -> FloatArray:
        return sign * length * np.stack([np.cos(angle), np.sin(angle)])[..., None] * along

    pitch = np.broadcast_to(_PITCHES[:, None], (len(_PITCHES), len(angles)))
    chassis = axis(robot.hinge_offset, pitch, _CHASSIS)  # (2, T, A, S)
    flipper = axis(robot.flipper_axle, pitch + sign * angles, _FLIPPER) + chassis[..., -1:]
    x, z = np.concatenate([chassis, flipper], axis=-1)  # (T, A, S), from the chassis centre
    at = places[:, None, None, None] + x  # (K, T, A, S)
    heights = np.interp(at, *ground) - z
    height = heights.max(axis=-1, keepdims=True)
    outward = np.where(heights >= height - _TOUCH, sign * x, -np.inf)
    outermost = outward.argmax(axis=-1)[..., None]
    across = np.maximum(0.0, np.take_along_axis(outward, outermost, axis=-1))
    above = robot.track_radius - np.take_along_axis(
        np.broadcast_to(z, at.shape), outermost, axis=-1
    )
    return _Contacts(height[..., 0], tipping_rise(across, above)[..., 0])


def _inflated(points: FloatArray, radius: float, low: float, high: float) -> FloatArray:
    """Return x and height of the ground from ``low`` to ``high``, inflated by ``radius`` [m]."""
    x = np.arange(low, high + _CELL, _CELL)
    n = math.floor(radius / _CELL)
    across = _CELL * np.arange(-n, n + 1)
    wide = np.concatenate([x[0] + across[:n], x, x[-1] + across[n + 1 :]])
    z = np.interp(wide, *points.T) if len(points) else np.full(len(wide), -radius)
    windows = np.lib.stride_tricks.sliding_window_view(z, 2 * n + 1)
    return np.stack([x, (windows + np.sqrt(radius**2 - across**2)).max(axis=-1)])
