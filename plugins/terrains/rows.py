"""Obstacles of one kind in a row: hurdles, piles, rails, blocks and waves."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import IntRange, Profile, Range, Terrain, terrain


@terrain("pallet")
class Pallet(Terrain):
    """Hurdles in a row with level ground between them, such as pallets on their long side.

    All hurdles of an episode have the same height and width; each clearance is drawn anew.
    """

    height: Range = Field(Range(0.1, 0.3), gt=0, le=0.8, description="height of the hurdles [m]")
    width: Range = Field(Range(0.15, 0.3), gt=0, le=5, description="width of the hurdles [m]")
    clearance: Range = Field(
        Range(0.3, 1.0), gt=0, le=5, description="ground between two hurdles [m]"
    )
    hurdles: IntRange = Field(IntRange(2, 4), ge=1, le=50, description="number of hurdles [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per hurdle."""
        height, width = self.height.sample(rng), self.width.sample(rng)
        x, points = 0.0, list[tuple[float, float]]()
        hurdles = self.hurdles.sample(rng)
        for _ in range(hurdles):
            points += [(x, 0.0), (x, height), (x + width, height), (x + width, 0.0)]
            x += width + self.clearance.sample(rng)
        return Profile(points, drawn={"hurdles": hurdles, "height": height, "width": width})


@terrain("plates")
class Plates(Terrain):
    """Thin upright plates across the track: boards on edge, curbstones, low walls.

    All plates of an episode are alike; each clearance is drawn anew. A tilted plate leans ahead,
    or with a negative tilt towards the robot; the ground below its overhang is filled.
    """

    thickness: Range = Field(
        Range(0.01, 0.1), gt=0, le=0.3, description="thickness of the plates [m]"
    )
    height: Range = Field(Range(0.1, 0.3), gt=0, le=0.8, description="height of the plates [m]")
    tilt: Range = Field(
        Range(-10.0, 10.0), ge=-30, le=30, description="tilt of the plates from upright [°]"
    )
    clearance: Range = Field(
        Range(0.15, 1.0), gt=0, le=5, description="ground between two plates [m]"
    )
    plates: IntRange = Field(IntRange(1, 3), ge=1, le=50, description="number of plates [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per plate."""
        thickness, height = self.thickness.sample(rng), self.height.sample(rng)
        tilt = self.tilt.sample(rng)
        lean = height * math.tan(math.radians(tilt))
        ahead, back = max(lean, 0.0), max(-lean, 0.0)
        x, points = 0.0, list[tuple[float, float]]()
        plates = self.plates.sample(rng)
        for _ in range(plates):
            top, end = x + ahead, x + ahead + thickness
            points += [(x, 0.0), (top, height), (end, height), (end + back, 0.0)]
            x = end + back + self.clearance.sample(rng)
        drawn = {"plates": plates, "height": height, "thickness": thickness, "tilt": tilt}
        return Profile(points, drawn=drawn)


@terrain("plum")
class Plum(Terrain):
    """Posts of unequal height, FTR-Bench's plum-blossom piles in profile.

    The gaps between the piles reach down to the ground.
    """

    height: Range = Field(Range(0.2, 0.5), gt=0, le=1, description="height of a pile [m]")
    width: Range = Field(Range(0.2, 0.5), gt=0, le=5, description="thickness of a pile [m]")
    clearance: Range = Field(Range(0.1, 0.3), gt=0, le=5, description="gap between two piles [m]")
    piles: IntRange = Field(IntRange(3, 6), ge=1, le=50, description="number of piles [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per pile."""
        x, points = 0.0, list[tuple[float, float]]()
        piles = self.piles.sample(rng)
        for _ in range(piles):
            height, end = self.height.sample(rng), x + self.width.sample(rng)
            points += [(x, 0.0), (x, height), (end, height), (end, 0.0)]
            x = end + self.clearance.sample(rng)
        return Profile(points, drawn={"piles": piles, "height": max(z for _, z in points)})


@terrain("rail")
class Rail(Terrain):
    """Square bars obliquely across the track (sizes and angles: FTR-Bench's rails).

    The angle lies between the bars and the robot's path. In the robot's side plane all lengths
    along the path grow by 1 / sin(angle), so that a bar of 0.2 m at 10° is 1.15 m long.
    """

    side: Range = Field(
        Range(0.2, 0.3), gt=0, le=0.8, description="height and width of the bars [m]"
    )
    angle: Range = Field(Range(10.0, 45.0), ge=5, le=90, description="crossing angle [°]")
    gauge: Range = Field(
        Range(0.2, 0.5), gt=0, le=5, description="gap between two bars, perpendicular to them [m]"
    )
    bars: IntRange = Field(IntRange(1, 2), ge=1, le=20, description="number of bars [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per bar."""
        side, angle = self.side.sample(rng), self.angle.sample(rng)
        # What is oblique to the path is longer along it.
        factor = 1 / math.sin(math.radians(angle))
        width, pitch = side * factor, (side + self.gauge.sample(rng)) * factor
        points = list[tuple[float, float]]()
        bars = self.bars.sample(rng)
        for bar in range(bars):
            x = bar * pitch
            points += [(x, 0.0), (x, side), (x + width, side), (x + width, 0.0)]
        return Profile(points, drawn={"bars": bars, "side": side, "angle": angle})


@terrain("rubble")
class Rubble(Terrain):
    """Blocks side by side, each with its own height and length."""

    height: Range = Field(Range(0.0, 0.3), ge=0, le=1, description="height of a block [m]")
    width: Range = Field(
        Range(0.15, 0.5), gt=0, le=5, description="length of a block, along the track [m]"
    )
    blocks: IntRange = Field(IntRange(4, 8), ge=1, le=100, description="number of blocks [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return flat tops with vertical faces between them."""
        x, points = 0.0, [(0.0, 0.0)]
        blocks = self.blocks.sample(rng)
        for _ in range(blocks):
            height, end = self.height.sample(rng), x + self.width.sample(rng)
            points += [(x, height), (end, height)]
            x = end
        drawn = {"blocks": blocks, "height": max(z for _, z in points)}
        return Profile([*points, (x, 0.0)], drawn=drawn)


_POINTS = 16
"""Number of chords per wave [-]."""


@terrain("wave")
class Wave(Terrain):
    """Equal cosine waves in a row, from trough to trough (sizes: FTR-Bench's waves).

    The steepest slope is atan(π · height / length): 51° for 0.4 m over 1 m.
    """

    length: Range = Field(Range(0.25, 1.0), gt=0.05, le=10, description="length of a wave [m]")
    height: Range = Field(
        Range(0.1, 0.4), gt=0, le=1, description="height of the waves, trough to crest [m]"
    )
    waves: IntRange = Field(IntRange(2, 4), ge=1, le=50, description="number of waves [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return sixteen chords per wave."""
        length, height = self.length.sample(rng), self.height.sample(rng)
        count = self.waves.sample(rng)
        # Each wave begins and ends in a trough.
        turns = np.linspace(0.0, count, count * _POINTS + 1)
        # Processors differ in the last digit of a cosine; they agree on nanometres.
        heights = np.round(height / 2 * (1 - np.cos(2 * np.pi * turns)), 9)
        points = np.column_stack([turns * length, heights])
        return Profile(points, drawn={"waves": count, "length": length, "height": height})
