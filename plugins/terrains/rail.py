"""Rails that are crossed at an angle."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow


@terrain("rail")
class Rail(DrawnRow):
    """Square bars that lie obliquely across the track (sizes and angles: FTR-Bench's rails).

    The angle lies between the bars and the robot's path. In the robot's side plane all lengths
    along the path grow by 1 / sin(angle), so that a bar of 0.2 m at 10° is 1.15 m long.
    """

    side_low: float = Field(
        0.2, gt=0, le=0.8, description="height and width of the thinnest bar [m]"
    )
    side_high: float = Field(
        0.3, gt=0, le=0.8, description="height and width of the thickest bar [m]"
    )
    angle_low: float = Field(10.0, ge=5, le=90, description="smallest crossing angle [°]")
    angle_high: float = Field(45.0, ge=5, le=90, description="largest crossing angle [°]")
    gauge_low: float = Field(
        0.2, gt=0, le=5, description="smallest gap between two bars, perpendicular to them [m]"
    )
    gauge_high: float = Field(
        0.5, gt=0, le=5, description="largest gap between two bars, perpendicular to them [m]"
    )
    fewest: int = Field(1, ge=1, le=20, description="smallest number of bars [-]")
    most: int = Field(2, ge=1, le=20, description="largest number of bars [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per bar."""
        side, angle = self.draw(rng, "side"), self.draw(rng, "angle")
        factor = 1 / math.sin(math.radians(angle))
        width, pitch = side * factor, (side + self.draw(rng, "gauge")) * factor
        points = list[tuple[float, float]]()
        bars = self.draw_count(rng)
        for bar in range(bars):
            x = bar * pitch
            points += [(x, 0.0), (x, side), (x + width, side), (x + width, 0.0)]
        return Profile(points, drawn={"bars": bars, "side": side, "angle": angle})
