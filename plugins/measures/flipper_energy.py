"""The energy of the flippers."""

from collections.abc import Sequence

from flipperctl.api import Measure, Transition, measure


@measure("flipper_energy")
class FlipperEnergy(Measure):
    """Integral of the absolute power (torque × angular speed) of all flippers [J].

    Braking counts as driving does, since a flipper's gear gives no energy back; a torque that holds
    a flipper still does no work. It is 0 in an engine that does not measure it.
    """

    unit = "J"
    digits = 1
    reached_only = True
    better = "lower"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the sum over the decisions [J]."""
        total = 0.0
        for t in episode:
            total += t.flipper_work or 0.0
        return total
