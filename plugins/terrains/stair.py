"""A flight of stairs, up or down (paper Sec. IV-A)."""

import math
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Profile, Terrain, terrain

from .flight import flight


@terrain("stair")
class Stair(Terrain):
    """Flights of equal steps; number and direction of the steps are drawn each episode.

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
    fewest: int = Field(3, ge=1, le=50, description="smallest number of steps [-]")
    most: int = Field(5, ge=1, le=50, description="largest number of steps [-]")
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
        if self.fewest > self.most:
            raise ValueError(f"fewest ({self.fewest}) must not exceed most ({self.most})")
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
        steps = int(rng.integers(self.fewest, self.most + 1))
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        rise = self.rise if up else -self.rise
        tread = self._tread(rise, rng)
        points = self._flight(0.0, 0.0, steps, tread, rise)
        x, z = points[-1]
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
