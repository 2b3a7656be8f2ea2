"""Single obstacles."""

import math
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Profile, Published, Range, Terrain, terrain


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

    height: Range = Field(
        Range(-0.4, 0.4), ge=-1, le=1, description="height of the step; negative leads down [m]"
    )
    platform: float = Field(
        0.0, ge=0, le=20, description="length of the platform after the first step [m]"
    )
    back: bool = Field(False, description="whether a second step leads back to ground level [-]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.back and self.platform <= 0:
            raise ValueError("back needs a platform longer than 0 m")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return one vertical face, or two with the platform between them."""
        height = self.height.sample(rng)
        points = [(0.0, 0.0), (0.0, height)]
        if self.platform:
            points.append((self.platform, height))
        if self.back:
            points.append((self.platform, 0.0))
        return Profile(points, drawn={"height": height})


@terrain("gap")
class Gap(Terrain):
    """A trench with vertical walls, shorter than the robot with level flippers."""

    width: Range = Field(Range(0.3, 0.8), gt=0, le=3, description="width of the trench [m]")
    depth: Range = Field(Range(0.2, 0.5), gt=0, le=3, description="depth of the trench [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points: down one wall and up the other."""
        width, depth = self.width.sample(rng), self.depth.sample(rng)
        points = [(0.0, 0.0), (0.0, -depth), (width, -depth), (width, 0.0)]
        return Profile(points, drawn={"width": width, "depth": depth})


@terrain("uplift")
class Uplift(Terrain):
    """A block with vertical faces, shorter than the robot (sizes: FTR-Bench's uplifts)."""

    height: Range = Field(Range(0.2, 0.4), gt=0, le=0.8, description="height of the block [m]")
    width: Range = Field(
        Range(0.2, 0.5), gt=0, le=5, description="length of the block, along the track [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points: up one face and down the other."""
        height, width = self.height.sample(rng), self.width.sample(rng)
        points = [(0.0, 0.0), (0.0, height), (width, height), (width, 0.0)]
        return Profile(points, drawn={"height": height, "width": width})


@terrain("ramp")
class Ramp(Terrain):
    """An incline up or down, a level platform and an equal incline back."""

    slope: Range = Field(Range(10.0, 35.0), gt=0, le=60, description="slope of the incline [°]")
    length: Range = Field(
        Range(0.8, 1.5), gt=0, le=10, description="length of an incline, along the slope [m]"
    )
    platform: float = Field(
        1.0, ge=0, le=20, description="length of the level platform, with ``back`` [m]"
    )
    direction: Literal["up", "down", "both"] = Field(
        "both", description="direction of the first incline; both draws one each episode [-]"
    )
    back: bool = Field(True, description="whether a second incline leads back [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return two points for one incline, or four for two."""
        degrees, length = self.slope.sample(rng), self.length.sample(rng)
        slope = math.radians(degrees)
        up = bool(rng.integers(2)) if self.direction == "both" else self.direction == "up"
        run, rise = length * math.cos(slope), length * math.sin(slope) * (1 if up else -1)
        points = [(0.0, 0.0), (run, rise)]
        if self.back:
            points += [(run + self.platform, rise), (2 * run + self.platform, 0.0)]
        return Profile(points, drawn={"slope": degrees, "length": length, "up": int(up)})


@terrain("curb_and_ramp")
class CurbAndRamp(Terrain):
    """A curb up, a pavement and a ramp down, or the reverse, sampled each episode."""

    height: Range = Field(Range(0.1, 0.4), gt=0, le=0.8, description="height of the curb [m]")
    slope: Range = Field(Range(10.0, 35.0), ge=1, le=60, description="slope of the ramp [°]")
    width: Range = Field(Range(0.5, 1.5), gt=0, le=20, description="width of the pavement [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return four points."""
        height, width = self.height.sample(rng), self.width.sample(rng)
        slope = self.slope.sample(rng)
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

    height: Range = Field(
        Range(0.4, 0.4), ge=-1, le=1, description="height of the step; negative leads down [m]"
    )
    platform: float = Field(
        3.0, ge=0, le=20, description="length of the platform after the first step [m]"
    )
    back: bool = Field(True, description="whether a second step leads back to ground level [-]")
