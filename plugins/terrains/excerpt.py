"""A piece of longer ground, drawn anew each episode."""

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, FloatArray, Profile, terrain

from .combinator import Combinator
from .drawn import Drawn
from .midway import STARTS
from .rough import Rough


@terrain("excerpt")
class Excerpt(Drawn, Combinator):
    """A piece of another terrain, such as of one long recording, with level ground at both ends.

    One recorded file thus gives as many episodes as it has places to begin at. Ground that is
    shorter than the piece is returned whole; the ground beside the line of a recording is left out.
    """

    terrain: AnyTerrain = Field(
        Rough(),
        description="the terrain: a name, or a mapping with a name and fields [-]",
    )
    length_low: float = Field(2.0, gt=0.1, le=100, description="shortest piece [m]")
    length_high: float = Field(5.0, gt=0.1, le=100, description="longest piece [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the points of the piece and its interpolated ends, with the inner label."""
        profile = self.terrain.labelled(rng)
        whole = profile.end - profile.start
        length = min(self.draw(rng, "length"), whole)
        first = profile.start + rng.random() * (whole - length)
        points = profile.points if length == whole else _piece(profile, first, first + length)
        known = {name: value for name, value in profile.drawn.items() if name not in STARTS}
        drawn = {**known, "piece_start": first - profile.start, "piece_length": length}
        return Profile(points, profile.label, drawn=drawn)


def _piece(profile: Profile, first: float, last: float) -> FloatArray:
    """Return the points between two x [m] with the interpolated ends, (V, 2)."""
    x, _ = profile.points.T
    inner = profile.points[(x > first) & (x < last)]
    ends = [(at, profile.height(at)) for at in (first, last)]
    return np.vstack([ends[:1], inner, ends[1:]])
