"""A reward of your own: flippers that stay low, as under a cable or with an arm on the robot.

Try it: ``flipperctl train terrain=gap experiment=searched ~rewards.flipper ~rewards.pitch
rewards.low=low rewards.travel=travel --plugins examples/low.py``
"""

from typing import ClassVar

import numpy as np

from flipperctl import api


@api.reward("low")
class Low(api.RewardTerm):
    """Penalise the height of both pairs' tips above the hinges, with the chassis level.

    A pair at its upper stop costs 1/2, one that is level or points down nothing.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True

    def __call__(self, t: api.Transition) -> float:
        raised = np.maximum(0.0, np.sin(t.after.front)) + np.maximum(0.0, np.sin(t.after.rear))
        return -api.limited(raised / (2 * np.sin(t.robot.angle_limit)), 0.0, 1.0)
