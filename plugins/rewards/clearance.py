"""Reward for clearance under the chassis."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("clearance")
class Clearance(RewardTerm):
    """Penalise a small gap between the chassis' underside and bumps between the hinges.

    A tracked chassis may lie flat on level ground, but it gets caught and tips on an edge under its
    middle. As for a vehicle's breakover angle, a bump is therefore ground that rises above the
    straight line between the ground points below the two hinges. The noses of a stair, which the
    tracks climb, are bumps too: on stairs the term asks the flippers to carry the chassis.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    enough: float = Field(0.05, gt=0, le=1, description="smallest gap without a penalty [m]")
    bump: float = Field(
        0.02, ge=0, le=1, description="smallest rise above the line between the hinges [m]"
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: -1 if the underside touches a bump, 0 without a bump."""
        cos, sin = math.cos(t.after.pitch), math.sin(t.after.pitch)
        (x, z), half = t.after.position, t.robot.hinge_offset * cos
        ground = t.profile.around(float(x), half, far=True)  # (P, 2) [m]
        ends = (x - half, x + half)
        chord = np.interp(ground[:, 0], ends, [t.profile.height(float(e)) for e in ends])
        bumps = ground[ground[:, 1] - chord > self.bump]
        if len(bumps) == 0:
            return 0.0
        up = cos * (bumps[:, 1] - z) - sin * (bumps[:, 0] - x)  # in frame R [m]
        gap = -float(up.max()) - t.robot.track_radius
        return -max(0.0, min(1.0, 1.0 - gap / self.enough))

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        cos, sin = np.cos(ts.after.pitch), np.sin(ts.after.pitch)
        (x, z), half = ts.after.position.T, ts.robot.hinge_offset * cos
        ground_x, ground_z = ts.profile.around_each(x, half, far=True)  # (M, P) [m]
        begin = ts.profile.heights(x - half)
        slope = (ts.profile.heights(x + half) - begin) / (2 * half)
        chord = begin[:, None] + slope[:, None] * (ground_x - (x - half)[:, None])
        rise = ground_z - chord - self.bump
        up = cos[:, None] * (ground_z - z[:, None]) - sin[:, None] * (ground_x - x[:, None])
        highest = np.where(rise > 0, up, -np.inf).max(axis=1, initial=-np.inf)  # in frame R [m]
        gap = -highest - ts.robot.track_radius  # infinite without a bump
        rewards: FloatArray = np.clip(gap, 0.0, self.enough) / self.enough - 1.0
        for index in np.flatnonzero((np.abs(rise) < _ROUNDING).any(axis=1)).tolist():
            rewards[index] = self(ts[index])
        return rewards


_ROUNDING = 1e-12
"""A rise this close to the limit [m] may count in one form and not in the other."""
