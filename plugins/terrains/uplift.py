"""A single block across the track."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import Drawn


@terrain("uplift")
class Uplift(Drawn):
    """A block with vertical faces, shorter than the robot (sizes: FTR-Bench's uplifts)."""

    height_low: float = Field(0.2, gt=0, le=0.8, description="lowest block [m]")
    height_high: float = Field(0.4, gt=0, le=0.8, description="highest block [m]")
    width_low: float = Field(0.2, gt=0, le=5, description="shortest block, along the track [m]")
    width_high: float = Field(0.5, gt=0, le=5, description="longest block, along the track [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points: up one face and down the other."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        points = [(0.0, 0.0), (0.0, height), (width, height), (width, 0.0)]
        return Profile(points, drawn={"height": height, "width": width})
