"""Flipper travel."""

from typing import ClassVar

from flipperctl.api import RewardTerm, Transition, reward


@reward("travel")
class Travel(RewardTerm):
    """The angle that both flipper pairs turned: wear, and most of the energy that a policy spends.

    It counts what the flippers did, not what they were told: a command beyond the reach costs
    nothing, being pushed by the ground does.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

    def __call__(self, t: Transition) -> float:
        """In [-1, 0]; -1 where both pairs turned by a whole step or more."""
        turned = abs(t.after.front - t.before.front) + abs(t.after.rear - t.before.rear)
        return -min(1.0, turned / (2 * t.robot.angle_step))
