"""Several terrains, one after another."""

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, Profile, terrain

from .combinator import Combinator
from .drawn import Drawn
from .midway import STARTS
from .ramp import Ramp
from .step import Step


@terrain("sequence")
class Sequence(Drawn, Combinator):
    """Terrains one after another; each begins at the height at which the previous one ended."""

    parts: tuple[AnyTerrain, ...] = Field(
        (Ramp(), Step()),
        min_length=1,
        description="the terrains in order: names, or mappings with a name and fields [-]",
    )
    spacing_low: float = Field(
        0.5, ge=0, le=20, description="shortest level ground between two terrains [m]"
    )
    spacing_high: float = Field(
        1.5, ge=0, le=20, description="longest level ground between two terrains [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of all parts, with their labels and what they drew."""
        end, points, labels = np.zeros(2), [], []
        drawn: dict[str, float] = {}
        for index, part in enumerate(self.parts):
            if index:
                end = end + np.array([self.draw(rng, "spacing"), 0.0])
            profile = part.labelled(rng)
            points.append(profile.points - profile.points[0] + end)
            labels.append(profile.label)
            for name, value in profile.drawn.items():
                if name not in STARTS:  # the sequence has its own start and finish
                    drawn[f"part{index + 1}_{name}"] = value
            end = points[-1][-1]
        return Profile(np.vstack(points), "+".join(labels), drawn=drawn)
