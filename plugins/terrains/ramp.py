"""A ramp, level ground on top, and a ramp back."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import Drawn


@terrain("ramp")
class Ramp(Drawn):
    """An incline up or down, a level platform and an equal incline back."""

    slope_low: float = Field(10.0, gt=0, le=60, description="smallest slope [°]")
    slope_high: float = Field(35.0, gt=0, le=60, description="largest slope [°]")
    length_low: float = Field(0.8, gt=0, le=10, description="shortest incline, along the slope [m]")
    length_high: float = Field(1.5, gt=0, le=10, description="longest incline, along the slope [m]")
    platform: float = Field(
        1.0, ge=0, le=20, description="length of the level platform, with ``back`` [m]"
    )
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the first incline; both draws one each episode [-]"
    )
    back: bool = Field(True, description="whether a second incline leads back [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return two points for one incline, or four for two."""
        degrees, length = self.draw(rng, "slope"), self.draw(rng, "length")
        slope = math.radians(degrees)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        run, rise = length * math.cos(slope), length * math.sin(slope) * (1 if up else -1)
        points = [(0.0, 0.0), (run, rise)]
        if self.back:
            points += [(run + self.platform, rise), (2 * run + self.platform, 0.0)]
        return Profile(points, drawn={"slope": degrees, "length": length, "up": int(up)})
