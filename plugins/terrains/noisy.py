"""A terrain with a rough surface."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, FloatArray, Profile, terrain

from .combinator import Combinator
from .stair import Stair


@terrain("noisy")
class Noisy(Combinator):
    """Another terrain with a rough surface; vertical faces keep their direction and height."""

    terrain: AnyTerrain = Field(
        Stair(),
        description="the terrain: a name, or a mapping with a name and fields [-]",
    )
    deviation: float = Field(
        0.01,
        ge=0,
        le=0.1,
        description="standard deviation of the heights at the knots, and 1.22 times that of the "
        "surface between them [m]",
    )
    correlation: float = Field(
        0.1, ge=0.02, le=5, description="distance between independent heights of the surface [m]"
    )
    margin: float = Field(
        0.5, ge=0, le=5, description="length of rough ground before and past the terrain [m]"
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the surface plus linearly interpolated noise, drawn every ``correlation`` [m]."""
        profile = self.terrain.labelled(rng)
        line = profile.extended(self.margin, self.margin)
        knots = np.arange(line[0, 0], line[-1, 0] + self.correlation, self.correlation)
        noise = rng.normal(0.0, self.deviation, len(knots))
        points = _with_knots(line, knots)
        rough = np.interp(points[:, 0], knots, noise)
        points = points + np.column_stack([np.zeros(len(points)), rough])
        run_up, run_out = (
            None if end is None else end - self.margin for end in (profile.run_up, profile.run_out)
        )
        return replace(profile, points=points, surface=None, run_up=run_up, run_out=run_out)


def _with_knots(line: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the polyline with points added at every knot within a segment, (V', 2) [m]."""
    pieces = []
    for (x0, z0), (x1, z1) in pairwise(line):
        inner = knots[(knots > x0) & (knots < x1)]
        heights = np.interp(inner, (x0, x1), (z0, z1))
        pieces += [np.array([[x0, z0]]), np.column_stack([inner, heights])]
    return np.vstack([*pieces, line[-1:]])
