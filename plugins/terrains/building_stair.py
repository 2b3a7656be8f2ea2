"""Stairs as buildings have them, from comfortable to steep."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import DrawnRow
from .flight import flight


@terrain("building_stair")
class BuildingStair(DrawnRow):
    """Flights of 20–45° in the proportions of buildings; ``stair`` has the paper's.

    Slope and stride are drawn, the step follows: by the rule that builders go by since Blondel
    (1675), two rises and a tread make a stride. So 30° at 0.63 m is a rise of 0.169 m on a tread of
    0.292 m, and 45° is 0.21 m on 0.21 m.
    """

    slope_low: float = Field(20.0, ge=5, le=60, description="smallest slope [°]")
    slope_high: float = Field(45.0, ge=5, le=60, description="largest slope [°]")
    stride_low: float = Field(0.6, ge=0.3, le=1, description="shortest stride, 2·rise + tread [m]")
    stride_high: float = Field(0.65, ge=0.3, le=1, description="longest stride, 2·rise + tread [m]")
    fewest: int = Field(3, ge=1, le=50, description="smallest number of steps [-]")
    most: int = Field(6, ge=1, le=50, description="largest number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "both", description="way of the flight; both draws one [-]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Vertical faces with treads between them."""
        slope, stride = math.tan(math.radians(self.draw(rng, "slope"))), self.draw(rng, "stride")
        tread = stride / (1 + 2 * slope)
        steps = self.draw_count(rng)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        return Profile(flight(0.0, 0.0, steps, tread, slope * tread * (1 if up else -1)))
