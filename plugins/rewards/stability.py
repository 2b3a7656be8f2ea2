"""Static stability."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, reward


@reward("stability")
class Stability(RewardTerm):
    """The static margin: level distance of the centre of mass to the nearer end of the support.

    The support reaches from the rearmost to the foremost point at which the robot's outline (three
    capsules: chassis and flipper pairs) touches the ground (McGhee and Frank 1968, in the side
    plane). Without a margin the robot tips over its last contact, or flies.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    enough: float = Field(0.2, gt=0, le=2, description="margin from which nothing is paid [m]")
    touch: float = Field(
        0.01, gt=0, le=0.1, description="gap to the ground that still counts as contact [m]"
    )
    flipper_share: float = Field(
        0.111, ge=0, lt=0.5, description="mass of each flipper pair as a share of the robot's [-]"
    )

    def __call__(self, t: Transition) -> float:
        """In [-1, 0]; -1 where there is no margin."""
        margin = self.margin(t)
        return -max(0.0, min(1.0, 1.0 - margin / self.enough))

    def margin(self, t: Transition) -> float:
        """Behind the decision; negative outside the support, minus infinity in the air [m]."""
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
        # Level, from the chassis' centre: each pair's mass lies half way along its axle.
        centre = self.flipper_share * float(front[0] + rear[0]) / 2
        return min(centre - float(support[0]), float(support[-1]) - centre)


def _direction(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])


def _distance(begin: FloatArray, end: FloatArray, points: FloatArray) -> FloatArray:
    """From the straight line between two points (2,) to each of the points (P, 2), (P,) [m]."""
    offset, along = points - begin, end - begin
    share = np.minimum(1.0, np.maximum(0.0, offset @ along / (along @ along)))
    nearest = offset - np.outer(share, along)
    distance: FloatArray = np.hypot(nearest[:, 0], nearest[:, 1])
    return distance
