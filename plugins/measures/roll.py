"""The roll of the chassis in 3-D; both are 0 in an engine of the side plane."""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("max_roll")
class MaxRoll(Measure):
    """Largest absolute roll at decisions [rad]."""

    unit = "rad"
    better = "lower"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the largest absolute roll, the start included [rad]."""
        return max(abs(episode[0].before.roll), *(abs(t.after.roll) for t in episode))


@measure("roll_variation")
class RollVariation(Measure):
    """Sum of the absolute roll changes from decision to decision, as θ̂_R for the pitch [rad]."""

    unit = "rad"
    reached_only = True
    better = "lower"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the sum of the absolute changes over each decision [rad]."""
        total = 0.0
        for t in episode:
            total += abs(t.after.roll - t.before.roll)
        return total
