"""The duration of an episode."""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("t_cost")
class Time(Measure):
    """Simulated time from the start to the end of the episode [s]."""

    unit = "s"
    digits = 1
    reached_only = True
    better = "lower"

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the time after the last decision [s]."""
        return episode[-1].after.time
