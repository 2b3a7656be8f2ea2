"""The number of decisions."""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("decisions")
class Decisions(Measure):
    """Number of decisions in the episode [-]."""

    def __call__(self, episode: Sequence[Transition]) -> int:
        """Return the number of transitions [-]."""
        return len(episode)
