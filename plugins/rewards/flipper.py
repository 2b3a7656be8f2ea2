"""R_flipper (paper Eq. 4)."""

import math
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import (
    FloatArray,
    RewardTerm,
    Transition,
    Transitions,
    candidate_angle,
    candidate_angles,
    reward,
)


@reward("flipper")
class Flipper(RewardTerm):
    """R_flipper (paper Eq. 4): penalise front flippers that deviate from the candidate angle."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    lambda_1: float = Field(1.0, gt=0, le=100, description="slope of the penalty [1/rad]")
    tolerance: float = Field(
        math.pi / 36, ge=0, le=1, description="largest deviation without a penalty [rad]"
    )
    near: float = Field(
        0.1,
        ge=0,
        le=1,
        description="distance from the hinge at which the considered terrain begins; not given in "
        "the paper [m]",
    )
    far: float = Field(
        0.45,
        gt=0,
        le=3,
        description="distance from the hinge at which the considered terrain ends; not given in "
        "the paper [m]",
    )

    @model_validator(mode="after")
    def _near_is_below_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near={self.near:g} must be below far={self.far:g}")
        return self

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: -1 if the deviation exceeds the tolerance by 1/λ1."""
        x = float(t.after.position[0])
        reach = t.robot.hinge_offset + self.far + t.robot.track_radius
        points = t.profile.around(x, reach) - t.after.position
        candidate = candidate_angle(points, t.after.pitch, t.robot, near=self.near, far=self.far)
        deviation = max(0.0, abs(t.after.front - candidate) - self.tolerance)
        return -min(1.0, self.lambda_1 * deviation)

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        reach = ts.robot.hinge_offset + self.far + ts.robot.track_radius
        x, z = ts.after.position.T
        along, up = ts.profile.around_each(x, reach)
        along -= x[:, None]
        up -= z[:, None]
        candidates = candidate_angles(
            along, up, ts.after.pitch, ts.robot, near=self.near, far=self.far
        )
        deviation = np.maximum(0.0, np.abs(ts.after.front - candidates) - self.tolerance)
        return -np.minimum(1.0, self.lambda_1 * deviation)
