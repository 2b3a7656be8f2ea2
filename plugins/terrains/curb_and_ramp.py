"""A pavement with a curb on one side and a ramp on the other."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import Drawn


@terrain("curb_and_ramp")
class CurbAndRamp(Drawn):
    """A curb up, a pavement and a ramp down, or the reverse, as drawn each episode."""

    height_low: float = Field(0.1, gt=0, le=0.8, description="lowest curb [m]")
    height_high: float = Field(0.4, gt=0, le=0.8, description="highest curb [m]")
    slope_low: float = Field(10.0, gt=0, le=60, description="smallest slope of the ramp [°]")
    slope_high: float = Field(35.0, gt=0, le=60, description="largest slope of the ramp [°]")
    width_low: float = Field(0.5, gt=0, le=20, description="narrowest pavement [m]")
    width_high: float = Field(1.5, gt=0, le=20, description="widest pavement [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        slope = self.draw(rng, "slope")
        run = height / math.tan(math.radians(slope))
        if curb_first := int(rng.integers(2)):
            points = [(0.0, 0.0), (0.0, height), (width, height), (width + run, 0.0)]
        else:
            points = [(0.0, 0.0), (run, height), (run + width, height), (run + width, 0.0)]
        drawn = {"height": height, "width": width, "slope": slope, "curb_first": curb_first}
        return Profile(points, drawn=drawn)
