"""Ground as rescue robots meet it: lips at the top of ramps, and stairs that are damaged."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from flipperctl.api import IntRange, Profile, Range, Terrain, terrain

from .stairs import blondel


@terrain("lip")
class Lip(Terrain):
    """An incline up with a lip, a sill or a log at its top, a platform and an incline back.

    A lip as wide as the platform is a step at the end of the ramp.
    """

    slope: Range = Field(Range(10.0, 25.0), gt=0, le=60, description="slope of the incline [°]")
    length: Range = Field(
        Range(0.8, 1.5), gt=0, le=10, description="length of an incline, along the slope [m]"
    )
    height: Range = Field(
        Range(0.04, 0.15), gt=0, le=0.8, description="height of the lip above the platform [m]"
    )
    width: Range = Field(Range(0.03, 0.25), gt=0, le=20, description="length of the lip [m]")
    platform: float = Field(
        1.0, gt=0, le=20, description="length of the level platform, the lip included [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return six points: up the incline, over the lip, and down again."""
        degrees, length = self.slope.sample(rng), self.length.sample(rng)
        height, width = self.height.sample(rng), self.width.sample(rng)
        slope = math.radians(degrees)
        run, rise = length * math.cos(slope), length * math.sin(slope)
        end = min(run + width, run + self.platform)
        points = [(0.0, 0.0), (run, rise), (run, rise + height), (end, rise + height), (end, rise)]
        points += [(run + self.platform, rise), (2 * run + self.platform, 0.0)]
        drawn = {"slope": degrees, "length": length, "height": height, "width": width}
        return Profile(points, drawn=drawn)


@terrain("damaged_stair")
class DamagedStair(Terrain):
    """A flight whose treads have sunk, tilt, have a raised nosing or are missing.

    Each tread is drawn by itself. Slope and stride are those of buildings, by Blondel's rule (1675)
    that two rises and a tread make a stride.
    """

    slope: Range = Field(Range(20.0, 38.0), ge=5, le=60, description="slope of the flight [°]")
    stride: Range = Field(Range(0.6, 0.65), ge=0.3, le=1, description="stride, 2·rise + tread [m]")
    steps: IntRange = Field(IntRange(4, 8), ge=2, le=50, description="number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the flight; both draws one each episode [-]"
    )
    sunk: Range = Field(
        Range(0.0, 0.06), ge=0, le=0.3, description="depth of a tread's sinking [m]"
    )
    tilt: Range = Field(
        Range(-10.0, 10.0), ge=-30, le=30, description="tilt of a tread, about its edge [°]"
    )
    nosing: Range = Field(
        Range(0.0, 0.03), ge=0, le=0.2, description="height of a rim of 3 cm at a tread's edge [m]"
    )
    missing: float = Field(
        0.15, ge=0, le=1, description="probability that a tread but the first and last is gone [-]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the treads from the foot of the flight to its top, mirrored if it leads down."""
        degrees, stride = self.slope.sample(rng), self.stride.sample(rng)
        (tread, rise), steps = blondel(degrees, stride), self.steps.sample(rng)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        # Upwards from the foot; a missing tread leaves the height of the one below it.
        points, height, gone = list[tuple[float, float]](), 0.0, 0
        for step in range(steps - 1):
            x, end = step * tread, (step + 1) * tread
            if 0 < step < steps - 2 and rng.random() < self.missing:
                gone += 1
                continue
            edge = (step + 1) * rise - self.sunk.sample(rng)
            back = edge + tread * math.tan(math.radians(self.tilt.sample(rng)))
            rim = min(0.03, tread / 2)
            crest = edge + self.nosing.sample(rng)
            points += [(x, height), (x, crest), (x + rim, crest), (x + rim, edge), (end, back)]
            height = back
        foot, top = (steps - 1) * tread, steps * rise
        points += [(foot, height), (foot, top)]
        # A flight down is the same one, from its top.
        if not up:
            points = [(foot - x, z - top) for x, z in reversed(points)]
        drawn = {"steps": steps, "slope": degrees, "rise": rise, "tread": tread}
        return Profile(points, drawn={**drawn, "missing": gone, "up": int(up)})
