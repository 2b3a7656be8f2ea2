"""Rails that are crossed at an angle."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow


@terrain("rail")
class Rail(DrawnRow):
    """Square bars that lie askew (sizes and angles: FTR-Bench's rails).

    The angle is that between the bars and the way: in the robot's side plane all lengths along
    the way grow by 1 / sin(angle), so that a bar of 0.2 m at 10° is 1.15 m long.
    """

    side_low: float = Field(0.2, gt=0, le=0.8, description="thinnest bar, height and width [m]")
    side_high: float = Field(0.3, gt=0, le=0.8, description="thickest bar, height and width [m]")
    angle_low: float = Field(10.0, ge=5, le=90, description="smallest crossing angle [°]")
    angle_high: float = Field(45.0, ge=5, le=90, description="largest crossing angle [°]")
    gauge_low: float = Field(
        0.2, gt=0, le=5, description="least ground between two bars, measured across them [m]"
    )
    gauge_high: float = Field(
        0.5, gt=0, le=5, description="most ground between two bars, measured across them [m]"
    )
    fewest: int = Field(1, ge=1, le=20, description="smallest number of bars [-]")
    most: int = Field(2, ge=1, le=20, description="largest number of bars [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Four points a bar."""
        side, stretch = self.draw(rng, "side"), 1 / math.sin(math.radians(self.draw(rng, "angle")))
        width, pitch = side * stretch, (side + self.draw(rng, "gauge")) * stretch
        points = list[tuple[float, float]]()
        for bar in range(self.draw_count(rng)):
            x = bar * pitch
            points += [(x, 0.0), (x, side), (x + width, side), (x + width, 0.0)]
        return Profile(points)
