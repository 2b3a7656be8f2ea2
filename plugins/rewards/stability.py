"""Reward for static stability."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, reward


@reward("stability")
class Stability(RewardTerm):
    """Penalise a small static stability margin.

    The margin is the horizontal distance of the centre of mass from the nearer end of the support.
    The support reaches from the rearmost to the foremost point at which the robot's outline (three
    capsules: chassis and flipper pairs) touches the ground (McGhee and Frank 1968, in the side
    plane). Without a margin the robot tips over its last contact or is in the air.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    enough: float = Field(0.2, gt=0, le=2, description="smallest margin without a penalty [m]")
    touch: float = Field(
        0.01, gt=0, le=0.1, description="largest gap to the ground that counts as contact [m]"
    )
    flipper_share: float = Field(
        0.111,
        ge=0,
        lt=0.5,
        description="mass of each flipper pair as a fraction of the robot's [-]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: -1 without a margin."""
        margin = self.margin(t)
        return -max(0.0, min(1.0, 1.0 - margin / self.enough))

    def margin(self, t: Transition) -> float:
        """Return the margin after the decision [m].

        It is negative outside the support and minus infinity in the air.
        """
        robot, state = t.robot, t.after
        ahead = robot.hinge_offset * _direction(state.pitch)
        front = ahead + robot.flipper_axle * _direction(state.pitch + state.front)
        rear = -ahead - robot.flipper_axle * _direction(state.pitch - state.rear)
        reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius + self.touch
        ground = t.profile.around(float(state.position[0]), reach) - state.position  # (P, 2) [m]
        axles = ((-ahead, ahead), (ahead, front), (rear, -ahead))
        gap = np.min([_distance(a, b, ground) for a, b in axles], axis=0) - robot.track_radius
        support = ground[gap <= self.touch, 0]
        if support.size == 0:
            return -math.inf
        # Horizontal distance from the chassis' centre: each pair's mass lies halfway along it.
        centre = self.flipper_share * float(front[0] + rear[0]) / 2
        return min(centre - float(support[0]), float(support[-1]) - centre)


def _direction(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])


def _distance(begin: FloatArray, end: FloatArray, points: FloatArray) -> FloatArray:
    """Return the distances (P,) [m] of points (P, 2) from the segment between two points (2,)."""
    offset, along = points - begin, end - begin
    fraction = np.minimum(1.0, np.maximum(0.0, offset @ along / (along @ along)))
    nearest = offset - np.outer(fraction, along)
    distance: FloatArray = np.hypot(nearest[:, 0], nearest[:, 1])
    return distance
