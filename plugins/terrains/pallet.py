"""Hurdles in a row."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow


@terrain("pallet")
class Pallet(DrawnRow):
    """Hurdles in a row with level ground between them, such as pallets on their long side.

    All hurdles of an episode have the same height and width; each clearance is drawn anew.
    """

    height_low: float = Field(0.1, gt=0, le=0.8, description="lowest hurdles [m]")
    height_high: float = Field(0.3, gt=0, le=0.8, description="highest hurdles [m]")
    width_low: float = Field(0.15, gt=0, le=5, description="narrowest hurdles [m]")
    width_high: float = Field(0.3, gt=0, le=5, description="widest hurdles [m]")
    clearance_low: float = Field(
        0.3, gt=0, le=5, description="shortest ground between two hurdles [m]"
    )
    clearance_high: float = Field(
        1.0, gt=0, le=5, description="longest ground between two hurdles [m]"
    )
    fewest: int = Field(2, ge=1, le=50, description="smallest number of hurdles [-]")
    most: int = Field(4, ge=1, le=50, description="largest number of hurdles [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per hurdle."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        x, points = 0.0, list[tuple[float, float]]()
        hurdles = self.draw_count(rng)
        for _ in range(hurdles):
            points += [(x, 0.0), (x, height), (x + width, height), (x + width, 0.0)]
            x += width + self.draw(rng, "clearance")
        return Profile(points, drawn={"hurdles": hurdles, "height": height, "width": width})
