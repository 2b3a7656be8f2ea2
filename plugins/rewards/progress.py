"""The way forward."""

from typing import ClassVar

from pydantic import Field

from flipperctl.api import RewardTerm, Transition, reward


@reward("progress")
class Progress(RewardTerm):
    """The chassis' way forward; backwards costs as much as forwards pays.

    The sum over a crossing is its length, whatever its speed. It competes with the other terms;
    ``shaped_progress`` only points the way.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    distance: float = Field(
        0.2, gt=0.01, le=10, description="way of one decision that pays 1, and no more [m]"
    )

    def __call__(self, t: Transition) -> float:
        """In [-1, 1]."""
        way = float(t.after.position[0] - t.before.position[0])
        return max(-1.0, min(1.0, way / self.distance))
