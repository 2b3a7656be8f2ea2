"""The pitch variation of an episode, at decisions and at 100 Hz.

The sums are loops because ``sum`` rounds floats differently from Python 3.12 on.
"""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import Measure, Transition, measure


@measure("pitch_variation")
class PitchVariation(Measure):
    """θ̂_R, the sum of the absolute pitch changes from decision to decision (paper Eq. 8) [rad]."""

    unit = "rad"
    reached_only = True
    better = "lower"

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the sum of the absolute changes over each decision [rad]."""
        total = 0.0
        for t in episode:
            total += abs(t.after.pitch - t.before.pitch)
        return total


@measure("pitch_variation_100hz")
class PitchVariation100Hz(Measure):
    """θ̂_R between poses 10 ms apart, which includes motion within decisions [rad]."""

    unit = "rad"
    reached_only = True
    better = "lower"

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the sum of the absolute changes within each decision [rad]."""
        total = 0.0
        for t in episode:
            pitch = t.path[:, 2]
            total += float(np.add.reduce(np.abs(pitch[1:] - pitch[:-1])))
        return total
