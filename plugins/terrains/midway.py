"""A terrain on which episodes start and finish, instead of before and past it."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from flipperctl.api import AnyTerrain, Profile, terrain

from .combinator import Combinator
from .stairwell import Stairwell

STARTS = ("start_on", "finish_on")
"""Numbers that it draws, which mean nothing where the ground is a part of another one."""


@terrain("midway")
class Midway(Combinator):
    """Another terrain, on which an episode starts, finishes or both, wherever the robot can stand.

    The robot then starts with the pitch that a slope or a stair gives it, and an episode may end on
    a slope. On ground shorter than ``shortest`` it starts before the first edge and finishes past
    the last, as elsewhere.
    """

    terrain: AnyTerrain = Field(
        Stairwell(),
        description="the terrain: a name, or a mapping with a name and fields [-]",
    )
    start: float = Field(
        0.5, ge=0, le=1, description="probability that an episode starts on the terrain [-]"
    )
    finish: float = Field(
        0.5, ge=0, le=1, description="probability that an episode finishes on the terrain [-]"
    )
    shortest: float = Field(
        1.5,
        ge=0.5,
        le=100,
        description="shortest way on the terrain from the start to the finish [m]",
    )

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the inner profile with its label and a start and a finish of its own."""
        profile = self.terrain.labelled(rng)
        starts, finishes = rng.random() < self.start, rng.random() < self.finish
        # All places between the edges from which ``shortest`` is left are equally probable.
        spare = profile.end - profile.start - self.shortest
        places = np.sort(rng.random(2)) * spare if starts and finishes else rng.random(2) * spare
        before = float(places[0]) if starts and spare > 0 else None
        behind = float(spare - places[1]) if finishes and spare > 0 else None
        drawn = {name: value for name, value in profile.drawn.items() if name not in STARTS}
        drawn |= {} if before is None else {"start_on": before}
        drawn |= {} if behind is None else {"finish_on": behind}
        return replace(
            profile,
            run_up=None if before is None else -before,
            run_out=None if behind is None else -behind,
            drawn=drawn,
        )
