"""A terrain of your own: ``flipperctl train terrain=ridge --plugins examples/ridge.py``."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, Terrain, terrain


@terrain("ridge")
class Ridge(Terrain):
    """One triangular ridge across the track."""

    height: float = Field(0.2, gt=0, le=0.4, description="ridge height [m]")
    base: float = Field(0.6, gt=0, le=5, description="ridge width at the ground [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return three points: up one side and down the other."""
        return Profile([(0, 0), (self.base / 2, self.height), (self.base, 0)])
