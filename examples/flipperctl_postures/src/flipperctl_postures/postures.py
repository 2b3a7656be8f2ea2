"""A controller for flipperctl: ``flipperctl eval postures``."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Controller, Perception, action_index, controller


@controller("postures")
class Postures(Controller):
    """Take one of three postures, as taught to operators: drive, climb or descend.

    The posture follows from the mean height of the ground ahead of the front hinge, relative to
    that of the ground under the robot.
    """

    look: float = Field(
        0.5, ge=0.1, le=2, description="length of considered ground ahead of the front hinge [m]"
    )
    edge: float = Field(
        0.06, ge=0.01, le=0.5, description="smallest rise or drop that is an obstacle [m]"
    )
    raised: float = Field(
        math.pi / 4, ge=0, le=1.05, description="front flipper angle while climbing [rad]"
    )
    lowered: float = Field(
        -math.pi / 12, ge=-1.05, le=0, description="front flipper angle while descending [rad]"
    )
    pushing: float = Field(
        0.0, ge=-1.05, le=1.05, description="rear flipper angle while climbing [rad]"
    )

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards the posture; hold it within half an angle step of it."""
        front, rear = self._posture(p)
        turns = (round(turn / p.robot.angle_step) for turn in (front - p.front, rear - p.rear))
        return action_index(*(max(-1, min(1, turn)) for turn in turns))

    def _posture(self, p: Perception) -> tuple[float, float]:
        """Return the angles of the front and the rear pair in the posture [rad]."""
        x, z = p.points.T
        hinge = p.robot.hinge_offset
        ahead = z[(x > hinge) & (x <= hinge + self.look)]
        below = z[np.abs(x) <= hinge]
        if not len(ahead) or not len(below):
            return 0.0, 0.0  # no ground is sensed
        rise = float(ahead.mean() - below.mean())  # [m]
        if rise > self.edge:
            return self.raised, self.pushing
        return (self.lowered, 0.0) if rise < -self.edge else (0.0, 0.0)
