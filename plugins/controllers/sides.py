"""A rule that sees both sides of the ground, for four flippers that turn alone."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, Perception, controller
from flipperctl.core.targets import angles_of

from .rules import Okada, turns_to


@controller("okada_sides")
class OkadaSides(Okada):
    """``okada`` for the left and for the right flippers alone, which keeps the roll small.

    With ``perception.sides=true`` each side follows the heights ahead of its own tracks. A pair
    takes the mean of both sides. ``margin`` is not used.
    """

    leaning: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of what one side has more below the chassis that is taken for leaning "
        "ground: 1 suits side slopes, 0 obstacles on one side [-]",
    )

    def act(self, p: Perception) -> tuple[float, ...]:
        """Turn each flipper one step towards its target; hold it within half a step of it."""
        sides = [replace(p, points=points) for points in below(p, self.leaning)]
        ends = (1.0, False), (self.rear_gain, True)
        # At the front and at the rear, left and right, (2, 2) [rad]
        targets = np.array([[g * self.angle(s, rear=rear) for s in sides] for g, rear in ends])
        goals = targets.ravel() if p.flippers else targets.mean(axis=1)
        return tuple(map(float, turns_to(goals.tolist(), angles_of(p), p.robot.angle_step)))


def below(p: Perception, leaning: float) -> list[FloatArray]:
    """Return the highest points of the bins of the left and the right side, each (N, 2) [m].

    They are in frame L. By the share ``leaning``, what a side has below the chassis counts as what
    the whole width has there. Without sides, both are the points of the whole width.
    """
    layout = p.layout
    if not layout.sides:
        return [p.points, p.points]
    x = layout.bin_width * (np.arange(layout.bins) + 0.5) - layout.reach
    # Below the whole width, the left and the right tracks; means before highest points
    kinds = p.observation[: layout.heights].reshape(3, -1, layout.bins)
    chassis = abs(x) <= p.robot.hinge_offset
    lower = kinds[0, 0, chassis].mean() - kinds[1:, 0, chassis].mean(axis=1)
    return [np.column_stack([x, kinds[1 + i, -1] + leaning * lower[i]]) for i in range(2)]
