"""Waves in a row."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow

_POINTS = 16
"""Number of chords per wave [-]."""


@terrain("wave")
class Wave(DrawnRow):
    """Equal cosine waves in a row, from trough to trough (sizes: FTR-Bench's waves).

    The steepest slope is atan(π · height / length): 51° for 0.4 m over 1 m.
    """

    length_low: float = Field(0.25, gt=0.05, le=10, description="shortest wave [m]")
    length_high: float = Field(1.0, gt=0.05, le=10, description="longest wave [m]")
    height_low: float = Field(0.1, gt=0, le=1, description="lowest wave, trough to crest [m]")
    height_high: float = Field(0.4, gt=0, le=1, description="highest wave, trough to crest [m]")
    fewest: int = Field(2, ge=1, le=50, description="smallest number of waves [-]")
    most: int = Field(4, ge=1, le=50, description="largest number of waves [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return sixteen chords per wave."""
        length, height = self.draw(rng, "length"), self.draw(rng, "height")
        count = self.draw_count(rng)
        turns = np.linspace(0.0, count, count * _POINTS + 1)
        heights = height / 2 * (1 - np.cos(2 * np.pi * turns))
        points = np.column_stack([turns * length, heights])
        return Profile(points, drawn={"waves": count, "length": length, "height": height})
