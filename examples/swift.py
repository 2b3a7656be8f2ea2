"""A reward of your own: a quick crossing, however much the chassis swings.

Try it: ``flipperctl train terrain=plum experiment=searched ~rewards.flipper ~rewards.pitch
rewards.swift=swift --plugins examples/swift.py``
"""

from typing import ClassVar

from pydantic import Field

from flipperctl import api


@api.reward("swift")
class Swift(api.RewardTerm):
    """Penalise each decision by the time that its way would have taken too long.

    Driving forwards at full ``speed`` costs nothing, standing 1/2 and driving backwards 1. Over
    a crossing the sum counts lost decisions, so that no policy gains by putting off the finish.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
    speed: float = Field(0.2, ge=0.01, le=5, description="speed that costs nothing [m/s]")

    def __call__(self, t: api.Transition) -> float:
        way = t.after.position[..., 0] - t.before.position[..., 0]
        full = self.speed * (t.after.time - t.before.time)
        return -api.limited(0.5 - 0.5 * way / full, 0.0, 1.0)
