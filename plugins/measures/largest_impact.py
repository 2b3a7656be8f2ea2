"""The hardest impact of an episode."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import Measure, Transition, measure


@measure("largest_impact")
class LargestImpact(Measure):
    """Largest change of the chassis centre's velocity within 10 ms [m/s].

    The velocities are means over samples 10 ms apart. The mass of the robot times this over 10 ms
    is the mean force of the impact.
    """

    unit = "m/s"
    better = "lower"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the largest length of the difference of two successive velocities [m/s]."""
        poses = [episode[0].path[:1], *(t.path[1:] for t in episode)]
        steps = np.diff(np.concatenate(poses)[:, :2], axis=0)  # (S, 2) [m]
        change = np.diff(steps / episode[0].sample_period, axis=0)
        return float(np.hypot(change[:, 0], change[:, 1]).max(initial=0.0))
