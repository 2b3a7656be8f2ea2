"""A controller for flipperctl: ``--controller postures``."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Controller, Perception, action_index, controller


@controller("postures")
class Postures(Controller):
    """Three postures, as operators are taught them: drive, climb, come down.

    Which one is taken follows from the ground's mean height ahead of the front hinge, against
    the ground under the robot.
    """

    look: float = Field(0.5, ge=0.1, le=2, description="ground ahead that is looked at [m]")
    edge: float = Field(0.06, ge=0.01, le=0.5, description="rise or drop that is an obstacle [m]")
    raised: float = Field(
        math.pi / 4, ge=0, le=1.05, description="front flippers while climbing [rad]"
    )
    lowered: float = Field(
        -math.pi / 12, ge=-1.05, le=0, description="front flippers while coming down [rad]"
    )
    pushing: float = Field(0.0, ge=-1.05, le=1.05, description="rear flippers while climbing [rad]")

    def act(self, p: Perception) -> int:
        """Both pairs one step towards the posture; nothing within half an angle step."""
        front, rear = self._posture(p)
        turns = (round(turn / p.robot.angle_step) for turn in (front - p.front, rear - p.rear))
        return action_index(*(max(-1, min(1, turn)) for turn in turns))

    def _posture(self, p: Perception) -> tuple[float, float]:
        """Angles of the front and the rear pair [rad]."""
        x, z = p.points.T
        hinge = p.robot.hinge_offset
        ahead = z[(x > hinge) & (x <= hinge + self.look)]
        below = z[np.abs(x) <= hinge]
        if not len(ahead) or not len(below):
            return 0.0, 0.0  # nothing is seen
        rise = float(ahead.mean() - below.mean())  # [m]
        if rise > self.edge:
            return self.raised, self.pushing
        return (self.lowered, 0.0) if rise < -self.edge else (0.0, 0.0)
