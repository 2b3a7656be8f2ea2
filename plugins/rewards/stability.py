"""Reward for static stability."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward

from ..load import load_offset, load_share


@reward("stability")
class Stability(RewardTerm):
    """Penalise a small static stability margin.

    The margin is the horizontal distance of the centre of mass from the nearer end of the support.
    The support reaches from the rearmost to the foremost point at which the robot's outline (three
    capsules: chassis and flipper pairs) touches the ground (McGhee and Frank 1968, in the side
    plane). Without a margin the robot tips over its last contact or is in the air. The centre of
    mass is that of the robot with its load.
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
        description="mass of each flipper pair as a fraction of the robot's without a load; the "
        "default is nubot's [-]",
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
        ground = (
            t.profile.around(float(state.position[0]), reach, far=True) - state.position
        )  # (P, 2) [m]
        axles = ((-ahead, ahead), (ahead, front), (rear, -ahead))
        gap = np.min([_distance(a, b, ground) for a, b in axles], axis=0) - robot.track_radius
        support = ground[gap <= self.touch, 0]
        if support.size == 0:
            return -math.inf
        # Horizontal distance from the chassis' centre: each pair's mass lies halfway along it.
        centre = self.flipper_share * float(front[0] + rear[0]) / 2
        x, z = load_offset(robot)
        centre *= 1 - load_share(robot)
        centre += x * math.cos(state.pitch) - z * math.sin(state.pitch)
        return min(centre - float(support[0]), float(support[-1]) - centre)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        robot, state = ts.robot, ts.after
        ahead = robot.hinge_offset * _directions(state.pitch)  # (M, 2) [m]
        front = ahead + robot.flipper_axle * _directions(state.pitch + state.front)
        rear = -ahead - robot.flipper_axle * _directions(state.pitch - state.rear)
        reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius + self.touch
        ground_x, ground_z = ts.profile.around_each(
            state.position[:, 0], reach, far=True
        )  # (M, P) [m]
        ground_x -= state.position[:, :1]
        ground_z -= state.position[:, 1:]
        squared = np.minimum(
            _squared_distances(-ahead, ahead, ground_x, ground_z),
            np.minimum(
                _squared_distances(ahead, front, ground_x, ground_z),
                _squared_distances(rear, -ahead, ground_x, ground_z),
            ),
        )
        gap = np.sqrt(squared) - robot.track_radius
        touching = gap <= self.touch
        first = np.where(touching, ground_x, np.inf).min(axis=1, initial=np.inf)
        last = np.where(touching, ground_x, -np.inf).max(axis=1, initial=-np.inf)
        centre = self.flipper_share * (front[:, 0] + rear[:, 0]) / 2
        x, z = load_offset(robot)
        centre *= 1 - load_share(robot)
        centre += x * np.cos(state.pitch) - z * np.sin(state.pitch)
        margin = np.minimum(centre - first, last - centre)  # minus infinity in the air
        rewards: FloatArray = np.clip(margin, 0.0, self.enough) / self.enough - 1.0
        for index in np.flatnonzero((np.abs(gap - self.touch) < _ROUNDING).any(axis=1)).tolist():
            rewards[index] = self(ts[index])
        return rewards


_ROUNDING = 1e-12
"""A gap this close to the limit [m] may count in one form and not in the other."""


def _direction(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])


def _distance(begin: FloatArray, end: FloatArray, points: FloatArray) -> FloatArray:
    """Return the distances (P,) [m] of points (P, 2) from the segment between two points (2,)."""
    offset, along = points - begin, end - begin
    fraction = np.minimum(1.0, np.maximum(0.0, offset @ along / (along @ along)))
    nearest = offset - np.outer(fraction, along)
    distance: FloatArray = np.hypot(nearest[:, 0], nearest[:, 1])
    return distance


def _directions(angle: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _squared_distances(
    begin: FloatArray, end: FloatArray, x: FloatArray, z: FloatArray
) -> FloatArray:
    """Return the squared distances (M, P) [m²] of points (M, P) from the segment of each row."""
    along = end - begin  # (M, 2)
    unit = along / (along * along).sum(axis=1, keepdims=True)
    x, z = x - begin[:, :1], z - begin[:, 1:]
    fraction = np.minimum(1.0, np.maximum(0.0, x * unit[:, :1] + z * unit[:, 1:]))
    x -= fraction * along[:, :1]
    z -= fraction * along[:, 1:]
    squared: FloatArray = x * x + z * z
    return squared
