"""Level ground."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, Terrain, terrain


@terrain("flat")
class Flat(Terrain):
    """Level ground, for checks and driving practice."""

    length: float = Field(2.0, gt=0, le=50, description="length of the track [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return two points."""
        return Profile([(0.0, 0.0), (self.length, 0.0)])
