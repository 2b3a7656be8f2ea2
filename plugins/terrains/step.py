"""One step, up or down (paper Sec. IV-A)."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Profile, Terrain, terrain


@terrain("step")
class Step(Terrain):
    """One step whose height is drawn each episode; a negative height leads down."""

    low: float = Field(-0.4, ge=-1, le=1, description="smallest height; negative leads down [m]")
    high: float = Field(0.4, ge=-1, le=1, description="largest height [m]")
    platform: float = Field(
        0.0,
        ge=0,
        le=20,
        description="length of the platform after the first step [m]",
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
