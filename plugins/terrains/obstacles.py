"""Single obstacles, and the base classes of terrains that draw new sizes each episode."""

import math
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Profile, Published, Terrain, terrain


class Drawn(Terrain):
    """Draw a quantity uniformly between its fields ``<quantity>_low`` and ``<quantity>_high``."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        fields = type(self).model_fields
        pairs = [(f, f.removesuffix("low") + "high") for f in fields if f.endswith("_low")]
        for low, high in [*pairs, ("fewest", "most")]:
            if low in fields and getattr(self, low) > getattr(self, high):
                raise ValueError(
                    f"{low} ({getattr(self, low):g}) must not exceed "
                    f"{high} ({getattr(self, high):g})"
                )
        return self

    def draw(self, rng: np.random.Generator, quantity: str) -> float:
        """Draw a value of the quantity, in the unit of its fields."""
        low, high = getattr(self, f"{quantity}_low"), getattr(self, f"{quantity}_high")
        return float(rng.uniform(low, high))


class DrawnRow(Drawn):
    """Also draw the number of parts in a row."""

    fewest: int = Field(2, ge=1, le=50, description="smallest number of parts [-]")
    most: int = Field(4, ge=1, le=50, description="largest number of parts [-]")

    def draw_count(self, rng: np.random.Generator) -> int:
        """Draw the number of parts, from ``fewest`` to ``most``."""
        return int(rng.integers(self.fewest, self.most + 1))


@terrain("flat")
class Flat(Terrain):
    """Level ground, for checks and driving practice."""

    length: float = Field(2.0, gt=0, le=50, description="length of the track [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return two points."""
        return Profile([(0.0, 0.0), (self.length, 0.0)])


@terrain("step")
class Step(Terrain):
    """One step, its height sampled each episode; a negative height leads down."""

    low: float = Field(-0.4, ge=-1, le=1, description="smallest height; negative leads down [m]")
    high: float = Field(0.4, ge=-1, le=1, description="largest height [m]")
    platform: float = Field(
        0.0, ge=0, le=20, description="length of the platform after the first step [m]"
    )
    back: bool = Field(False, description="whether a second step leads back to ground level [-]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low ({self.low:g}) must not exceed high ({self.high:g})")
        if self.back and self.platform <= 0:
            raise ValueError("back needs a platform longer than 0 m")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return one vertical face, or two with the platform between them."""
        height = float(rng.uniform(self.low, self.high))
        points = [(0.0, 0.0), (0.0, height)]
        if self.platform:
            points.append((self.platform, height))
        if self.back:
            points.append((self.platform, 0.0))
        return Profile(points, drawn={"height": height})


@terrain("gap")
class Gap(Drawn):
    """A trench with vertical walls, shorter than the robot with level flippers."""

    width_low: float = Field(0.3, gt=0, le=3, description="narrowest trench [m]")
    width_high: float = Field(0.8, gt=0, le=3, description="widest trench [m]")
    depth_low: float = Field(0.2, gt=0, le=3, description="shallowest trench [m]")
    depth_high: float = Field(0.5, gt=0, le=3, description="deepest trench [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points: down one wall and up the other."""
        width, depth = self.draw(rng, "width"), self.draw(rng, "depth")
        points = [(0.0, 0.0), (0.0, -depth), (width, -depth), (width, 0.0)]
        return Profile(points, drawn={"width": width, "depth": depth})


@terrain("uplift")
class Uplift(Drawn):
    """A block with vertical faces, shorter than the robot (sizes: FTR-Bench's uplifts)."""

    height_low: float = Field(0.2, gt=0, le=0.8, description="lowest block [m]")
    height_high: float = Field(0.4, gt=0, le=0.8, description="highest block [m]")
    width_low: float = Field(0.2, gt=0, le=5, description="shortest block, along the track [m]")
    width_high: float = Field(0.5, gt=0, le=5, description="longest block, along the track [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points: up one face and down the other."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        points = [(0.0, 0.0), (0.0, height), (width, height), (width, 0.0)]
        return Profile(points, drawn={"height": height, "width": width})


@terrain("ramp")
class Ramp(Drawn):
    """An incline up or down, a level platform and an equal incline back."""

    slope_low: float = Field(10.0, gt=0, le=60, description="smallest slope [°]")
    slope_high: float = Field(35.0, gt=0, le=60, description="largest slope [°]")
    length_low: float = Field(0.8, gt=0, le=10, description="shortest incline, along the slope [m]")
    length_high: float = Field(1.5, gt=0, le=10, description="longest incline, along the slope [m]")
    platform: float = Field(
        1.0, ge=0, le=20, description="length of the level platform, with ``back`` [m]"
    )
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the first incline; both draws one each episode [-]"
    )
    back: bool = Field(True, description="whether a second incline leads back [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return two points for one incline, or four for two."""
        degrees, length = self.draw(rng, "slope"), self.draw(rng, "length")
        slope = math.radians(degrees)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        run, rise = length * math.cos(slope), length * math.sin(slope) * (1 if up else -1)
        points = [(0.0, 0.0), (run, rise)]
        if self.back:
            points += [(run + self.platform, rise), (2 * run + self.platform, 0.0)]
        return Profile(points, drawn={"slope": degrees, "length": length, "up": int(up)})


@terrain("curb_and_ramp")
class CurbAndRamp(Drawn):
    """A curb up, a pavement and a ramp down, or the reverse, sampled each episode."""

    height_low: float = Field(0.1, gt=0, le=0.8, description="lowest curb [m]")
    height_high: float = Field(0.4, gt=0, le=0.8, description="highest curb [m]")
    slope_low: float = Field(10.0, gt=0, le=60, description="smallest slope of the ramp [°]")
    slope_high: float = Field(35.0, gt=0, le=60, description="largest slope of the ramp [°]")
    width_low: float = Field(0.5, gt=0, le=20, description="narrowest pavement [m]")
    width_high: float = Field(1.5, gt=0, le=20, description="widest pavement [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points."""
        height, width = self.draw(rng, "height"), self.draw(rng, "width")
        slope = self.draw(rng, "slope")
        run = height / math.tan(math.radians(slope))
        if curb_first := int(rng.integers(2)):
            points = [(0.0, 0.0), (0.0, height), (width, height), (width + run, 0.0)]
        else:
            points = [(0.0, 0.0), (run, height), (run + width, height), (run + width, 0.0)]
        drawn = {"height": height, "width": width, "slope": slope, "curb_first": curb_first}
        return Profile(points, drawn=drawn)


@terrain("paper_step")
class PaperStep(Step):
    """Step 0.4 m up, 3 m of platform, 0.4 m down; 5 m with the margins (paper Tab. I)."""

    published: ClassVar[tuple[Published, ...]] = (
        Published("AT-D3QN (paper)", "paper", 28.07, 3.43, 1.11),
        Published("operators (paper)", "paper", 46.17, 4.02, 2.92),
    )

    low: float = Field(0.4, ge=-1, le=1, description="smallest height; negative leads down [m]")
    platform: float = Field(
        3.0, ge=0, le=20, description="length of the platform after the first step [m]"
    )
    back: bool = Field(True, description="whether a second step leads back to ground level [-]")
