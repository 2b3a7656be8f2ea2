"""Several flights of one building, with landings between them."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import Drawn
from .flight import flight


@terrain("stairwell")
class Stairwell(Drawn):
    """Flights with landings, each of which leads on in the direction of the last, or turns.

    A flight up may be followed by one up or down. All steps of an episode are alike, by Blondel's
    rule as those of ``building_stair``; the length of each flight and landing is drawn anew.
    """

    slope_low: float = Field(20.0, ge=5, le=60, description="smallest slope [°]")
    slope_high: float = Field(40.0, ge=5, le=60, description="largest slope [°]")
    stride_low: float = Field(0.6, ge=0.3, le=1, description="shortest stride, 2·rise + tread [m]")
    stride_high: float = Field(0.65, ge=0.3, le=1, description="longest stride, 2·rise + tread [m]")
    flights_low: int = Field(2, ge=1, le=10, description="smallest number of flights [-]")
    flights_high: int = Field(3, ge=1, le=10, description="largest number of flights [-]")
    fewest: int = Field(3, ge=1, le=50, description="smallest number of steps of a flight [-]")
    most: int = Field(8, ge=1, le=50, description="largest number of steps of a flight [-]")
    landing_low: float = Field(0.9, gt=0.05, le=10, description="shortest landing [m]")
    landing_high: float = Field(2.0, gt=0.05, le=10, description="longest landing [m]")
    up: float = Field(0.5, ge=0, le=1, description="probability that the first flight leads up [-]")
    turn: float = Field(
        0.5,
        ge=0,
        le=1,
        description="probability that a flight leads up after one down, or down after one up [-]",
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return vertical faces with treads and landings between them."""
        degrees, stride = self.draw(rng, "slope"), self.draw(rng, "stride")
        slope = math.tan(math.radians(degrees))
        tread = stride / (1 + 2 * slope)
        flights = int(rng.integers(self.flights_low, self.flights_high + 1))
        sign = 1 if rng.random() < self.up else -1
        points, total, turns, first_up = list[tuple[float, float]](), 0, 0, int(sign > 0)
        for index in range(flights):
            x, z = points[-1] if points else (0.0, 0.0)
            if index:
                x += self.draw(rng, "landing")
                if rng.random() < self.turn:
                    sign, turns = -sign, turns + 1
            steps = int(rng.integers(self.fewest, self.most + 1))
            points += flight(x, z, steps, tread, sign * slope * tread)
            total += steps
        drawn = {
            "steps": total,
            "flights": flights,
            "turns": turns,
            "slope": degrees,
            "rise": slope * tread,
            "tread": tread,
            "up": first_up,
        }
        return Profile(points, drawn=drawn)
