"""A terrain for flipperctl: ``terrain=trunk``."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Profile, Terrain, terrain


@terrain("trunk")
class Trunk(Terrain):
    """Fallen trees across the track, sunk into the soil, of random diameter and spacing."""

    fewest: int = Field(1, ge=1, le=10, description="smallest number of trunks [-]")
    most: int = Field(3, ge=1, le=10, description="largest number of trunks [-]")
    thinnest: float = Field(0.15, ge=0.05, le=0.6, description="smallest diameter [m]")
    thickest: float = Field(0.35, ge=0.05, le=0.6, description="largest diameter [m]")
    gap: float = Field(0.5, ge=0, le=5, description="largest gap between two trunks [m]")
    sunk: float = Field(0.2, ge=0, le=0.5, description="fraction of the diameter in the soil [-]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for low, high in (("fewest", "most"), ("thinnest", "thickest")):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low} must not exceed {high}")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return arcs with level ground between them; overhangs below the axis are filled in."""
        points: list[tuple[float, float]] = []
        x = 0.0
        for _ in range(rng.integers(self.fewest, self.most + 1)):
            radius = rng.uniform(self.thinnest, self.thickest) / 2
            centre = (1 - 2 * self.sunk) * radius  # height of the trunk's axis [m]
            points.append((x, 0.0))
            for angle in np.linspace(np.pi, 0.0, 13):
                at = x + radius * (1 + np.cos(angle))
                points.append((at, centre + radius * np.sin(angle)))
            x += 2 * radius
            points.append((x, 0.0))
            x += rng.uniform(0.0, self.gap)
        return Profile(points)
