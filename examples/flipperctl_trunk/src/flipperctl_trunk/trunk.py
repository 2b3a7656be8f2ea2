"""A terrain for flipperctl: ``terrain=trunk``."""

import numpy as np
from pydantic import Field

from flipperctl.api import IntRange, Profile, Range, Terrain, terrain


@terrain("trunk")
class Trunk(Terrain):
    """Fallen trees across the track, sunk into the soil, of random diameter and spacing."""

    trunks: IntRange = Field(IntRange(1, 3), ge=1, le=10, description="number of trunks [-]")
    diameter: Range = Field(Range(0.15, 0.35), ge=0.05, le=0.6, description="diameter [m]")
    gap: float = Field(0.5, ge=0, le=5, description="largest gap between two trunks [m]")
    sunk: float = Field(0.2, ge=0, le=0.5, description="fraction of the diameter in the soil [-]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return arcs with level ground between them; overhangs below the axis are filled in."""
        points: list[tuple[float, float]] = []
        x = 0.0
        for _ in range(self.trunks.sample(rng)):
            radius = self.diameter.sample(rng) / 2
            centre = (1 - 2 * self.sunk) * radius  # height of the trunk's axis [m]
            points.append((x, 0.0))
            for angle in np.linspace(np.pi, 0.0, 13):
                at = x + radius * (1 + np.cos(angle))
                points.append((at, centre + radius * np.sin(angle)))
            x += 2 * radius
            points.append((x, 0.0))
            x += rng.uniform(0.0, self.gap)
        return Profile(points)
