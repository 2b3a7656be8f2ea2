"""A controller that plans by contact geometry alone, over the ground that the robot perceives.

In: a perception. Out: an action. How the robot would rest at places ahead with each pair of flipper
angles is computed in ``resting``; here a dynamic programme chooses the angles.
"""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import (
    ACTIONS,
    Controller,
    FloatArray,
    Perception,
    action_index,
    controller,
)

from ..posture import with_masses
from ..resting import Rest, rest

_TURNS = sorted(ACTIONS, key=lambda turns: abs(turns[0]) + abs(turns[1]))
"""Turns (front, rear) of the actions; among equally good ones the first is taken."""
_STEPS = 4
"""Largest number of angle steps each way from 0 among the planned angles [-]."""
_STEEP = math.atan(0.75)
"""Slope of the chassis centre's path, with the flippers held, from which it costs [rad]."""
_HOOKED = math.pi / 4
"""Slope of the ground at a contact from which it costs [rad]."""
_MARGIN_COST = 5.0
"""Cost of each metre that the stability margin lacks, as pitch [rad/m]."""


@controller("geometric")
class Geometric(Controller):
    """Plan the flippers for the least pitch change, by contact geometry.

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

    steep: float = Field(
        0.5,
        ge=0,
        le=5,
        description="cost of each radian by which the ground is steeper than 45° where a part "
        "touches it, which hooks flippers on edges [-]",
    )

    def act(self, p: Perception) -> int:
        """Return the first turns of the best plan."""
        robot = with_masses(p.robot)
        # Few angles, since a plan is made for every pair of them
        step = max(robot.angle_step, robot.angle_limit / _STEPS)
        count = math.floor(robot.angle_limit / step + 1e-9)
        angles = step * np.arange(-count, count + 1.0)  # (A,) [rad]
        places = robot.track_speed * robot.decision_period * np.arange(self.horizon + 1.0)
        poses = rest(p.points, robot, places, angles, angles)
        # The plan begins at the measured angles, and at the measured pitch in place of a resting
        # one.
        front, rear = (int(np.abs(angles - angle).argmin()) for angle in (p.front, p.rear))
        costs = self._costs(poses, places[1])
        poses.pitch[0] = p.pitch
        # Equal plans differ in digits that depend on the processor; the first of them is taken.
        best = np.round(self._options(poses.pitch, costs)[:, front, rear], 9).argmin()
        return action_index(*_TURNS[best])

    def _costs(self, poses: Rest, stride: float) -> FloatArray:
        """Return the costs of the poses at the K places ahead, ``stride`` [m] apart, (K, A, A)."""
        lift = (poses.height - poses.height.min(axis=(1, 2), keepdims=True))[1:]
        # What each pose costs, and the way to it
        lacking = np.maximum(0.0, self.margin - poses.margin)[1:]
        slope = np.arctan(np.diff(poses.height, axis=0) / stride)
        climb = self.climb * np.maximum(0.0, slope - _STEEP)
        # A part is hooked where the way to a place begins or where it ends.
        hooked = self.steep * np.maximum(0.0, poses.slope - _HOOKED)
        costs: FloatArray = self.clearance * lift + _MARGIN_COST * lacking + climb
        return costs + np.maximum(hooked[1:], hooked[:-1])

    def _options(self, pitch: FloatArray, costs: FloatArray) -> FloatArray:
        """Return the cost of the best plan that begins with each of ``_TURNS``, (9, A, A) [rad].

        ``pitch``: pitch at each place with each front and rear angle, the present place first,
        (K + 1, A, A) [rad]. ``costs``: costs of the poses at the places ahead, (K, A, A) [rad].
        """
        count = pitch.shape[1]
        to_go = np.abs(pitch[-1] - pitch[-1, count // 2, count // 2])  # from each pair of angles
        there = np.zeros((len(costs), count + 2, count + 2))
        there[:, 1:-1, 1:-1] = pitch[1:]
        changes = np.abs(_after_turns(there) - pitch[:-1, None])  # (K, 9, A, A)
        turned = self.turn * np.abs(_TURNS).sum(axis=1)[:, None, None]
        # Backwards from the last place: what remains to be paid from each pair of angles
        then = np.full((count + 2, count + 2), math.inf)  # angles beyond the stops
        for cost, change in zip(costs[::-1], changes[::-1], strict=True):
            then[1:-1, 1:-1] = cost + to_go
            options: FloatArray = _after_turns(then) + change + turned
            to_go = options.min(axis=0)
        return options


def _after_turns(padded: FloatArray) -> FloatArray:
    """Return the values after each of ``_TURNS``, (…, 9, A, A), of ones (…, A + 2, A + 2)."""
    count = padded.shape[-1] - 2
    windows = np.lib.stride_tricks.sliding_window_view(padded, (count, count), axis=(-2, -1))
    front, rear = np.transpose(_TURNS) + 1
    after: FloatArray = windows[..., front, rear, :, :]
    return after
