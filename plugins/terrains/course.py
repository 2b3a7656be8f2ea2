"""Several obstacles in a row, drawn anew each episode."""

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, Profile, terrain

from .drawn import DrawnRow
from .gap import Gap
from .mix import Mix
from .pallet import Pallet
from .plum import Plum
from .ramp import Ramp
from .stair import Stair
from .step import Step
from .uplift import Uplift


@terrain("course")
class Course(DrawnRow, Mix):
    """Draw number, kinds and sizes of the obstacles in a row; ``sequence`` has a fixed order.

    Each obstacle begins at the height at which the previous one ended. What is drawn tells the
    number of obstacles, and the index of each one's kind within ``parts``.
    """

    parts: tuple[AnyTerrain, ...] = Field(
        (Step(), Stair(), Ramp(), Gap(), Uplift(), Pallet(), Plum()),
        min_length=1,
        description="the terrains: names, or mappings with a name and fields [-]",
    )
    fewest: int = Field(2, ge=1, le=10, description="smallest number of obstacles [-]")
    most: int = Field(5, ge=1, le=10, description="largest number of obstacles [-]")
    spacing_low: float = Field(
        0.3, ge=0, le=20, description="shortest level ground between two obstacles [m]"
    )
    spacing_high: float = Field(
        1.5, ge=0, le=20, description="longest level ground between two obstacles [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of all obstacles."""
        obstacles = self.draw_count(rng)
        drawn: dict[str, float] = {"obstacles": obstacles}
        end, points = np.zeros(2), []
        for place in range(1, obstacles + 1):
            if place > 1:
                end = end + np.array([self.draw(rng, "spacing"), 0.0])
            kind = self.draw_part(rng)
            found = self.parts[kind].labelled(rng).points
            points.append(found - found[0] + end)
            end = points[-1][-1]
            drawn[f"kind{place}"] = kind
        return Profile(np.vstack(points), drawn=drawn)
