"""Stairs with the proportions of buildings, from comfortable to steep."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow
from .flight import flight


@terrain("building_stair")
class BuildingStair(DrawnRow):
    """Flights of 20–45° in the proportions of buildings; ``stair`` has those of the paper.

    Slope and stride are drawn. Rise and tread follow from Blondel's rule (1675) that two rises and
    a tread make a stride. Thus 30° and 0.63 m give a rise of 0.169 m and a tread of 0.292 m, and
    45° gives 0.21 m and 0.21 m.
    """

    slope_low: float = Field(20.0, ge=5, le=60, description="smallest slope [°]")
    slope_high: float = Field(45.0, ge=5, le=60, description="largest slope [°]")
    stride_low: float = Field(0.6, ge=0.3, le=1, description="shortest stride, 2·rise + tread [m]")
    stride_high: float = Field(0.65, ge=0.3, le=1, description="longest stride, 2·rise + tread [m]")
    fewest: int = Field(3, ge=1, le=50, description="smallest number of steps [-]")
    most: int = Field(6, ge=1, le=50, description="largest number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the flight; both draws one each episode [-]"
    )
    landing_every: int = Field(
        0, ge=0, le=50, description="steps between two landings; 0: no landing [-]"
    )
    landing: float = Field(
        1.2, gt=0.05, le=10, description="length of a landing, which replaces a tread [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return vertical faces with treads between them."""
        degrees, stride = self.draw(rng, "slope"), self.draw(rng, "stride")
        slope = math.tan(math.radians(degrees))
        tread = stride / (1 + 2 * slope)
        steps = self.draw_count(rng)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        rise = slope * tread * (1 if up else -1)
        points = flight(0.0, 0.0, steps, tread, rise, self.landing_every, self.landing)
        drawn = {"steps": steps, "slope": degrees, "rise": abs(rise), "tread": tread, "up": int(up)}
        return Profile(points, drawn=drawn)
