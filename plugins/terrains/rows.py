"""Obstacles of one kind in a row: hurdles, piles, rails, blocks and waves."""

import math

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .obstacles import DrawnRow


@terrain("pallet")
class Pallet(DrawnRow):
    """Hurdles in a row with level ground between them, such as pallets on their long side.

    All hurdles of an episode have the same height and width; each clearance is drawn anew.
    """

    height_low: float = Field(0.1, gt=0, le=0.8, description="lowest hurdles [m]")
    height_high: float = Field(0.3, gt=0, le=0.8, description="highest hurdles [m]")
    width_low: float = Field(0.15, gt=0, le=5, description="narrowest hurdles [m]")
    width_high: float = Field(0.3, gt=0, le=5, description="widest hurdles [m]")
    clearance_low: float = Field(
        0.3, gt=0, le=5, description="shortest ground between two hurdles [m]"
    )
    clearance_high: float = Field(
        1.0, gt=0, le=5, description="longest ground between two hurdles [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per hurdle."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        x, points = 0.0, list[tuple[float, float]]()
        hurdles = self.draw_count(rng)
        for _ in range(hurdles):
            points += [(x, 0.0), (x, height), (x + width, height), (x + width, 0.0)]
            x += width + self.draw(rng, "clearance")
        return Profile(points, drawn={"hurdles": hurdles, "height": height, "width": width})


@terrain("plates")
class Plates(DrawnRow):
    """Thin upright plates across the track: boards on edge, curbstones, low walls.

    All plates of an episode are alike; each clearance is drawn anew. A tilted plate leans ahead,
    or with a negative tilt towards the robot; the ground below its overhang is filled.
    """

    thickness_low: float = Field(0.01, gt=0, le=0.3, description="thinnest plates [m]")
    thickness_high: float = Field(0.1, gt=0, le=0.3, description="thickest plates [m]")
    height_low: float = Field(0.1, gt=0, le=0.8, description="lowest plates [m]")
    height_high: float = Field(0.3, gt=0, le=0.8, description="highest plates [m]")
    tilt_low: float = Field(-10.0, ge=-30, le=30, description="smallest tilt from upright [°]")
    tilt_high: float = Field(10.0, ge=-30, le=30, description="largest tilt from upright [°]")
    clearance_low: float = Field(
        0.15, gt=0, le=5, description="shortest ground between two plates [m]"
    )
    clearance_high: float = Field(
        1.0, gt=0, le=5, description="longest ground between two plates [m]"
    )
    fewest: int = Field(1, ge=1, le=50, description="smallest number of plates [-]")
    most: int = Field(3, ge=1, le=50, description="largest number of plates [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points per plate."""
        thickness, height = self.draw(rng, "thickness"), self.draw(rng, "height")
        tilt = self.draw(rng, "tilt")
        lean = height * math.tan(math.radians(tilt))
        ahead, back = max(lean, 0.0), max(-lean, 0.0)
        x, points = 0.0, list[tuple[float, float]]()
        plates = self.draw_count(rng)
        for _ in range(plates):
            top, end = x + ahead, x + ahead + thickness
            points += [(x, 0.0), (top, height), (end, height), (end + back, 0.0)]
            x = end + back + self.draw(rng, "clearance")
        drawn = {"plates": plates, "height": height, "thickness": thickness, "tilt": tilt}
        return Profile(points, drawn=drawn)


@terrain("plum")
class Plum(DrawnRow):
    """Posts of unequal height, FTR-Bench's plum-blossom piles in profile.

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


@terrain("rail")
class Rail(DrawnRow):
    """Square bars obliquely across the track (sizes and angles: FTR-Bench's rails).

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


@terrain("rubble")
class Rubble(DrawnRow):
    """Blocks side by side, each with its own height and length."""

    height_low: float = Field(0.0, ge=0, le=1, description="lowest block [m]")
    height_high: float = Field(0.3, ge=0, le=1, description="highest block [m]")
    width_low: float = Field(0.15, gt=0, le=5, description="shortest block, along the track [m]")
    width_high: float = Field(0.5, gt=0, le=5, description="longest block, along the track [m]")
    fewest: int = Field(4, ge=1, le=100, description="smallest number of blocks [-]")
    most: int = Field(8, ge=1, le=100, description="largest number of blocks [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return flat tops with vertical faces between them."""
        x, points = 0.0, [(0.0, 0.0)]
        blocks = self.draw_count(rng)
        for _ in range(blocks):
            height, end = self.draw(rng, "height"), x + self.draw(rng, "width")
            points += [(x, height), (end, height)]
            x = end
        drawn = {"blocks": blocks, "height": max(z for _, z in points)}
        return Profile([*points, (x, 0.0)], drawn=drawn)


_POINTS = 16
"""Number of chords per wave [-]."""


@terrain("wave")
class Wave(DrawnRow):
    """Equal cosine waves in a row, from trough to trough (sizes: FTR-Bench's waves).

    The steepest slope is atan(π · height / length): 51° for 0.4 m over 1 m.
    """

    length_low: float = Field(0.25, gt=0.05, le=10, description="shortest wave [m]")
    length_high: float = Field(1.0, gt=0.05, le=10, description="longest wave [m]")
    height_low: float = Field(0.1, gt=0, le=1, description="lowest wave, trough to crest [m]")
    height_high: float = Field(0.4, gt=0, le=1, description="highest wave, trough to crest [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return sixteen chords per wave."""
        length, height = self.draw(rng, "length"), self.draw(rng, "height")
        count = self.draw_count(rng)
        turns = np.linspace(0.0, count, count * _POINTS + 1)
        heights = height / 2 * (1 - np.cos(2 * np.pi * turns))
        points = np.column_stack([turns * length, heights])
        return Profile(points, drawn={"waves": count, "length": length, "height": height})
