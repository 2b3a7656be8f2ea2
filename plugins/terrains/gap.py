"""A trench across the track."""

import numpy as np
from pydantic import Field

from flipperctl.api import Profile, terrain

from .drawn import Drawn


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
