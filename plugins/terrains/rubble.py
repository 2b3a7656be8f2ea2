"""Blocks of random size, side by side."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow


@terrain("rubble")
class Rubble(DrawnRow):
    """Blocks side by side, each with its own height and length."""

    height_low: float = Field(0.0, ge=0, le=1, description="lowest block [m]")
    height_high: float = Field(0.3, ge=0, le=1, description="highest block [m]")
    width_low: float = Field(0.15, gt=0, le=5, description="shortest block, along the track [m]")
    width_high: float = Field(0.5, gt=0, le=5, description="longest block, along the track [m]")
    fewest: int = Field(4, ge=1, le=100, description="smallest number of blocks [-]")
    most: int = Field(8, ge=1, le=100, description="largest number of blocks [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return flat tops with vertical faces between them."""
        x, points = 0.0, [(0.0, 0.0)]
        blocks = self.draw_count(rng)
        for _ in range(blocks):
            height, end = self.draw(rng, "height"), x + self.draw(rng, "width")
            points += [(x, height), (end, height)]
            x = end
        drawn = {"blocks": blocks, "height": max(z for _, z in points)}
        return Profile([*points, (x, 0.0)], drawn=drawn)
