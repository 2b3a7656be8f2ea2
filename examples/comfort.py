"""A reward of your own: a casualty on the robot shall not feel it pitch.

Try it: ``flipperctl train terrain=ramp rewards.comfort=comfort --plugins examples/comfort.py``
"""

from typing import ClassVar

from pydantic import Field

from flipperctl.api import RewardTerm, Transition, limited, reward


@reward("comfort")
class Comfort(RewardTerm):
    """Penalise the pitch that a casualty on the robot would feel."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
    comfortable: float = Field(
        0.17, ge=0, le=1, description="largest absolute pitch without a penalty [rad]"
    )
    slope: float = Field(2.0, gt=0, le=100, description="penalty for each radian beyond [1/rad]")

    def __call__(self, t: Transition) -> float:
        excess = abs(t.after.pitch) - self.comfortable
        return -limited(self.slope * excess, 0.0, 1.0)
