"""A measure of your own: how high the robot climbs.

Try it: ``flipperctl eval --controller okada terrain=step --plugins examples/highest.py``
"""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("highest")
class Highest(Measure):
    """Largest height of the chassis centre in the world [m]."""

    unit = "m"
    digits = 3

    def __call__(self, episode: Sequence[Transition]) -> float:
        return max(float(t.path[:, 1].max()) for t in episode)
