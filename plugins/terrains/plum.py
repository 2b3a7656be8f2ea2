"""Piles of unequal height with gaps between them."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow


@terrain("plum")
class Plum(DrawnRow):
    """Plum-blossom piles in profile: posts of unequal height (sizes: FTR-Bench's plum piles).

    The gaps between the piles reach down to the ground.
    """

    height_low: float = Field(0.2, gt=0, le=1, description="lowest pile [m]")
    height_high: float = Field(0.5, gt=0, le=1, description="highest pile [m]")
    width_low: float = Field(0.2, gt=0, le=5, description="thinnest pile [m]")
    width_high: float = Field(0.5, gt=0, le=5, description="thickest pile [m]")
    clearance_low: float = Field(0.1, gt=0, le=5, description="smallest gap between two piles [m]")
    clearance_high: float = Field(0.3, gt=0, le=5, description="largest gap between two piles [m]")
    fewest: int = Field(3, ge=1, le=50, description="smallest number of piles [-]")
    most: int = Field(6, ge=1, le=50, description="largest number of piles [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per pile."""
        x, points = 0.0, list[tuple[float, float]]()
        piles = self.draw_count(rng)
        for _ in range(piles):
            height, end = self.draw(rng, "height"), x + self.draw(rng, "width")
            points += [(x, 0.0), (x, height), (end, height), (end, 0.0)]
            x = end + self.draw(rng, "clearance")
        return Profile(points, drawn={"piles": piles, "height": max(z for _, z in points)})
