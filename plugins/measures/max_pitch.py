"""The largest pitch of the chassis."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import Measure, Transition, measure


@measure("max_pitch")
class MaxPitch(Measure):
    """Largest absolute pitch over poses 10 ms apart [rad]."""

    unit = "rad"
    better = "lower"

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the maximum over all poses, including that at the start [rad]."""
        pitches = np.concatenate([t.path[:, 2] for t in episode])
        return float(np.maximum.reduce(np.abs(pitches)))
