"""The time in which the robot stood still."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import Measure, Transition, measure

from .masses import track_speed

_SLOW = 0.1
"""Fraction of the belts' speed below which the chassis stands still [-]."""


@measure("standstill")
class Standstill(Measure):
    """Time in which the chassis centre moved slower than a tenth of the belts' speed [s]."""

    unit = "s"
    digits = 1
    better = "lower"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the time of the samples, 10 ms each, with a smaller mean speed [s]."""
        period = episode[0].sample_period
        poses = [episode[0].path[:1], *(t.path[1:] for t in episode)]
        steps = np.diff(np.concatenate(poses)[:, :2], axis=0)  # (S, 2) [m]
        limit = _SLOW * track_speed(episode[0].robot) * period  # [m]
        return period * int(np.count_nonzero(np.hypot(steps[:, 0], steps[:, 1]) < limit))
