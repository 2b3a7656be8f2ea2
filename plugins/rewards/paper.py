"""The paper's three reward terms: R_flipper, R_pitch and R_end (Eqs. 4 to 7)."""

import math
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import (
    LAST_PITCHES,
    RewardTerm,
    Transition,
    candidate_angles,
    limited,
    reward,
)

_LEAST_COSINE = 0.1
"""Bound of the length that is searched for terrain, reached at a pitch of 84°, overturned [-]."""


@reward("flipper")
class Flipper(RewardTerm):
    """R_flipper (paper Eq. 4): penalise front flippers off the candidate angle.

    It is -1 if the deviation exceeds the tolerance by 1/λ1.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
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
        """Return the reward in [-1, 0]."""
        robot, state = t.robot, t.after
        middle, reach = self._reach(t)
        x, z = t.profile.around_each(middle, reach, far=True) - state.position.T[..., None]
        candidate = candidate_angles(x, z, state.pitch, robot, near=self.near, far=self.far)
        deviation = abs(state.front - candidate) - self.tolerance
        return -limited(self.lambda_1 * deviation, 0.0, 1.0)

    def _reach(self, t: Transition) -> tuple[Any, Any]:
        """Return middle and half length of the world x that can hold considered terrain [m].

        ``near`` and ``far`` count along the chassis: x cos θ_R + z sin θ_R lies between them, for
        any height z that the profile has.
        """
        (x, z), (level, relief) = t.after.position.T, t.profile.relief
        cos, sin = limited(np.cos(t.after.pitch), _LEAST_COSINE, 1.0), np.sin(t.after.pitch)
        # Ground of any height may lie at the considered distance, so that the range is wide.
        middle = t.robot.hinge_offset + (self.near + self.far) / 2 - sin * (level - z)
        half = (self.far - self.near) / 2 + abs(sin) * relief
        return x + middle / cos, half / cos + t.robot.track_radius


@reward("pitch")
class Pitch(RewardTerm):
    """R_pitch (paper Eq. 6): penalise pitch variation, most strongly at a steep pitch.

    It is -1 if the mean variation exceeds 1/λ2, or if the pitch is beyond ±π/4 and growing. The
    paper averages the variation over the next k decisions. Here it is averaged over the last k
    pitches, which are known when the reward is computed.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
    lambda_2: float = Field(8.0, gt=0, le=1000, description="slope of the penalty [1/rad]")
    window: int = Field(
        3, ge=2, le=100, description="k, number of last pitches; not given in the paper [-]"
    )

    @property
    def not_predicted(self) -> str:  # type: ignore[override]  # by the window
        """What a search lacks: pitches of longer ago than it carries."""
        if self.window <= LAST_PITCHES:
            return ""
        return f"a window of {self.window} pitches; {LAST_PITCHES} are known"

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        steep = abs(t.after.pitch)
        growing = (steep > math.pi / 4) & (steep > abs(t.before.pitch))
        pitches = t.pitches[..., -self.window :]
        changes = np.abs(pitches[..., 1:] - pitches[..., :-1])
        variation = np.add.reduce(changes, axis=-1) / changes.shape[-1]  # faster than numpy's mean
        return -limited(self.lambda_2 * variation + growing, 0.0, 1.0)


@reward("end")
class End(RewardTerm):
    """R_end (paper Eq. 7): +R for reaching the finish, -R for any other outcome."""

    elementwise: ClassVar[bool] = True
    settlement: float = Field(10.0, gt=0, le=1e6, description="R; not given in the paper [-]")

    def __call__(self, t: Transition) -> float:
        """Return ±R at the end of the episode, and 0 before."""
        return 2 * self.settlement * t.reached - self.settlement * t.ended
