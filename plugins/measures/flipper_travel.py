"""The motion of the flippers."""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("flipper_travel")
class FlipperTravel(Measure):
    """Sum of the absolute turns of both flipper pairs from decision to decision [rad]."""

    unit = "rad"
    reached_only = True
    better = "lower"

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the sum of the absolute turns [rad]."""
        total = 0.0
        for t in episode:
            total += abs(t.after.front - t.before.front) + abs(t.after.rear - t.before.rear)
        return total
