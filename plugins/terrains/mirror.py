"""A terrain in the reverse direction."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, MirroredSurface, Profile, terrain

from .combinator import Combinator
from .curb_and_ramp import CurbAndRamp


@terrain("mirror")
class Mirror(Combinator):
    """Another terrain, crossed from its end to its start."""

    terrain: AnyTerrain = Field(
        CurbAndRamp(),
        description="the terrain: a name, or a mapping with a name and fields [-]",
    )
    probability: float = Field(
        1.0, ge=0, le=1, description="probability that an episode's terrain is reversed [-]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points in reverse order, beginning at (0, 0), with the same label.

        What the inner terrain drew is told as it was before it was reversed; ``mirrored`` is 1 if
        the whole is reversed, by one mirror or by an odd number.
        """
        profile = self.terrain.labelled(rng)
        if rng.random() >= self.probability:
            return replace(profile, drawn={"mirrored": 0, **profile.drawn})
        last = profile.points[-1]
        surface = profile.surface and MirroredSurface(profile.surface, (last[0], last[1]))
        drawn = {**profile.drawn, "mirrored": 1 - profile.drawn.get("mirrored", 0)}
        points = (profile.points[::-1] - last) * (-1.0, 1.0)
        return replace(
            profile,
            points=points,
            surface=surface,
            drawn=drawn,
            run_up=profile.run_out,
            run_out=profile.run_up,
        )
