"""Stairs: single flights, the stairs of buildings, and the paper's."""

import math
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import IntRange, Profile, Published, Range, Terrain, terrain


def flight(
    x: float,
    z: float,
    steps: int,
    tread: float,
    rise: float,
    landing_every: int = 0,
    landing: float = 0.0,
) -> list[tuple[float, float]]:
    """Return two points (x, z) per step [m], from the foot of the first face to the last edge.

    The flight begins at (x, z) with a vertical face; a negative ``rise`` leads down. After every
    ``landing_every`` steps, unless it is 0, a landing of length ``landing`` [m] replaces the tread.
    """
    points = []
    for step in range(steps):
        landings = step // landing_every if landing_every else 0
        # A landing replaces the tread of its step.
        edge = x + step * tread + landings * (landing - tread)
        points.append((edge, z + step * rise))
        points.append((edge, z + (step + 1) * rise))
    return points


def blondel(degrees: float, stride: float) -> tuple[float, float]:
    """Return tread and rise [m] of which two rises and a tread make a ``stride`` [m].

    ``degrees``: slope of the flight. The rule is Blondel's (1675).
    """
    slope = math.tan(math.radians(degrees))
    tread = stride / (1 + 2 * slope)
    return tread, slope * tread


@terrain("stair")
class Stair(Terrain):
    """Flights of equal steps, up or down, their number sampled each episode.

    With ``back``, a second flight leads from the platform back to ground level.
    """

    rise: float = Field(0.2, gt=0, le=0.5, description="height of a step [m]")
    tread: float = Field(
        0.3, gt=0.05, le=2, description="depth of a step that leads up; 0.3 m gives 33.7° [m]"
    )
    tread_down: float = Field(0.3, gt=0.05, le=2, description="depth of a step that leads down [m]")
    tread_spread: float = Field(
        0.0, ge=0, le=1, description="largest deviation of each flight's drawn tread [m]"
    )
    steps: IntRange = Field(IntRange(3, 5), ge=1, le=50, description="number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the first flight; both draws one each episode [-]"
    )
    landing_every: int = Field(
        0, ge=0, le=50, description="steps between two landings; 0: no landing [-]"
    )
    landing: float = Field(
        1.2, gt=0.05, le=10, description="length of a landing, which replaces a tread [m]"
    )
    platform: float = Field(
        0.0, ge=0, le=20, description="length of the platform after the first flight [m]"
    )
    back: bool = Field(False, description="whether a second flight leads back [-]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.back and self.platform <= 0:
            raise ValueError("back needs a platform longer than 0 m")
        if min(self.tread, self.tread_down) - self.tread_spread <= 0.05:
            raise ValueError(
                f"treads of {self.tread:g} and {self.tread_down:g} m within ± "
                f"{self.tread_spread:g} m must stay deeper than 0.05 m"
            )
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return vertical faces with treads between them."""
        steps = self.steps.sample(rng)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        rise = self.rise if up else -self.rise
        tread = self._tread(rise, rng)
        points = self._flight(0.0, 0.0, steps, tread, rise)
        x, z = points[-1]
        # The second flight begins at the end of the platform, a point that it need not repeat.
        if self.platform:
            points.append((x + self.platform, z))
        if self.back:
            back = self._tread(-rise, rng)
            points += self._flight(x + self.platform, z, steps, back, -rise)[1:]
        slope = math.degrees(math.atan2(self.rise, tread))
        drawn = {"steps": steps, "slope": slope, "rise": self.rise, "tread": tread, "up": int(up)}
        return Profile(points, drawn=drawn)

    def _flight(
        self, x: float, z: float, steps: int, tread: float, rise: float
    ) -> list[tuple[float, float]]:
        return flight(x, z, steps, tread, rise, self.landing_every, self.landing)

    def _tread(self, rise: float, rng: np.random.Generator) -> float:
        middle = self.tread if rise > 0 else self.tread_down
        if self.tread_spread == 0:
            return middle
        return rng.uniform(middle - self.tread_spread, middle + self.tread_spread)


@terrain("building_stair")
class BuildingStair(Terrain):
    """Flights of 20–45° in the proportions of buildings; ``stair`` has the paper's.

    Slope and stride are drawn. Rise and tread follow from Blondel's rule (1675) that two rises and
    a tread make a stride. Thus 30° and 0.63 m give a rise of 0.169 m and a tread of 0.292 m, and
    45° gives 0.21 m and 0.21 m.
    """

    slope: Range = Field(Range(20.0, 45.0), ge=5, le=60, description="slope of the flight [°]")
    stride: Range = Field(Range(0.6, 0.65), ge=0.3, le=1, description="stride, 2·rise + tread [m]")
    steps: IntRange = Field(IntRange(3, 6), ge=1, le=50, description="number of steps [-]")
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
        degrees, stride = self.slope.sample(rng), self.stride.sample(rng)
        tread, rise = blondel(degrees, stride)
        steps = self.steps.sample(rng)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        rise *= 1 if up else -1
        points = flight(0.0, 0.0, steps, tread, rise, self.landing_every, self.landing)
        drawn = {"steps": steps, "slope": degrees, "rise": abs(rise), "tread": tread, "up": int(up)}
        return Profile(points, drawn=drawn)


@terrain("stairwell")
class Stairwell(Terrain):
    """Flights with landings; each leads on in the direction of the last, or turns.

    A flight up may be followed by one up or down. All steps of an episode are alike, by Blondel's
    rule as in ``building_stair``; the length of each flight and landing is drawn anew.
    """

    slope: Range = Field(Range(20.0, 40.0), ge=5, le=60, description="slope of the flights [°]")
    stride: Range = Field(Range(0.6, 0.65), ge=0.3, le=1, description="stride, 2·rise + tread [m]")
    flights: IntRange = Field(IntRange(2, 3), ge=1, le=10, description="number of flights [-]")
    steps: IntRange = Field(
        IntRange(3, 8), ge=1, le=50, description="number of steps of a flight [-]"
    )
    landing: Range = Field(Range(0.9, 2.0), gt=0.05, le=10, description="length of a landing [m]")
    up: float = Field(0.5, ge=0, le=1, description="probability that the first flight leads up [-]")
    turn: float = Field(
        0.5,
        ge=0,
        le=1,
        description="probability that a flight leads up after one down, or down after one up [-]",
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return vertical faces with treads and landings between them."""
        degrees, stride = self.slope.sample(rng), self.stride.sample(rng)
        tread, rise = blondel(degrees, stride)
        flights = self.flights.sample(rng)
        sign = 1 if rng.random() < self.up else -1
        points, total, turns, first_up = list[tuple[float, float]](), 0, 0, int(sign > 0)
        # Flights with landings between them, each onward or back
        for index in range(flights):
            x, z = points[-1] if points else (0.0, 0.0)
            if index:
                x += self.landing.sample(rng)
                if rng.random() < self.turn:
                    sign, turns = -sign, turns + 1
            steps = self.steps.sample(rng)
            points += flight(x, z, steps, tread, sign * rise)
            total += steps
        drawn = {
            "steps": total,
            "flights": flights,
            "turns": turns,
            "slope": degrees,
            "rise": rise,
            "tread": tread,
            "up": first_up,
        }
        return Profile(points, drawn=drawn)


@terrain("paper_stair")
class PaperStair(Stair):
    """Six steps 0.2 × 0.3 m up, a platform, six 0.2 × 0.2 m down; 6.5 m with the margins.

    The paper (Tab. I) gives the total length and the steps, which leave 2 m for the platform.
    """

    published: ClassVar[tuple[Published, ...]] = (
        Published("AT-D3QN (paper)", "paper", 41.21, 4.53, 2.60),
        Published("operators (paper)", "paper", 76.53, 6.30, 3.88),
    )

    steps: IntRange = Field(IntRange(6, 6), ge=1, le=50, description="number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "up", description="direction of the first flight; both draws one each episode [-]"
    )
    platform: float = Field(
        2.0, ge=0, le=20, description="length of the platform after the first flight [m]"
    )
    back: bool = Field(True, description="whether a second flight leads back [-]")
    tread_down: float = Field(0.2, gt=0.05, le=2, description="depth of a step that leads down [m]")
