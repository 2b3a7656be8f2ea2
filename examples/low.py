"""A reward of your own: flippers that stay low, as under a cable or with an arm on the robot.

Try it: ``flipperctl train terrain=gap experiment=searched ~rewards.flipper ~rewards.pitch
+reward@rewards.low=low +reward@rewards.travel=travel --plugins examples/low.py``
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

    def __call__(self, t: api.Transition) -> float:
        raised = max(0.0, np.sin(t.after.front)) + max(0.0, np.sin(t.after.rear))
        return -min(1.0, float(raised / (2 * np.sin(t.robot.angle_limit))))

    def array(self, ts: api.Transitions) -> api.FloatArray:
        raised = np.maximum(0.0, np.sin(ts.after.front)) + np.maximum(0.0, np.sin(ts.after.rear))
        return -np.minimum(1.0, raised / (2 * np.sin(ts.robot.angle_limit)))
