"""Reward against flipper travel."""

from typing import ClassVar

import numpy as np

from flipperctl.api import FloatArray, RewardTerm, Transition, Transitions, reward


@reward("travel")
class Travel(RewardTerm):
    """Penalise the angle by which both flipper pairs turn, since turning costs wear and energy.

    The term measures the motion, not the command: a command beyond the angle limit costs nothing,
    while a flipper that the ground pushes away does.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]: -1 if the pairs turned by two whole steps in total."""
        turned = abs(t.after.front - t.before.front) + abs(t.after.rear - t.before.rear)
        return -min(1.0, turned / (2 * t.robot.angle_step))

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        front, rear = ts.after.front - ts.before.front, ts.after.rear - ts.before.rear
        turned = np.abs(front) + np.abs(rear)  # (M,) [rad]
        return -np.minimum(1.0, turned / (2 * ts.robot.angle_step))
