"""A sensor of your own: the height at the centre of each bin, with errors that grow with distance.

Try it: ``flipperctl eval okada perception=ruler --plugins examples/ruler.py``
"""

import numpy as np
from pydantic import Field

from flipperctl import api


@api.sensor("ruler")
class Ruler(api.Sensor):
    """Measure the height of the ground at the centre of each bin."""

    error: float = Field(
        0.0, ge=0, le=0.1, description="standard deviation of a height 1 m away [m]"
    )

    def over(self, profile: api.Profile, margin: float) -> api.GroundSensor:
        return RulerOver(profile, self)


class RulerOver:
    """A ruler on the ground of one episode; see ``flipperctl.api.GroundSensor``."""

    def __init__(self, profile: api.Profile, settings: Ruler) -> None:
        self._profile = profile
        self._x = (np.arange(settings.bins) + 0.5) * settings.bin_width - settings.reach
        self._errors = settings.error * np.abs(self._x)

    def sense(
        self, state: api.RobotState, rng: np.random.Generator
    ) -> tuple[api.SensedGround, api.SensedAngles]:
        x, z = state.position
        heights = np.array([self._profile.height(x + ahead) - z for ahead in self._x])
        heights += self._errors * rng.standard_normal(len(heights))
        ground = api.SensedGround(np.column_stack([self._x, heights]))
        return ground, api.SensedAngles(front=state.front, rear=state.rear, pitch=state.pitch)
