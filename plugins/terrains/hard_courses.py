"""The ground of all courses, with more of what policies learn last."""

from pydantic import Field

from flipperctl.api import AnyTerrain, terrain

from .all_courses import MIX
from .building_stair import BuildingStair
from .midway import Midway
from .mix import Mix
from .paper_stair import PaperStair
from .plum import Plum
from .ramp import Ramp

_SHARES = (20.0, 3.0, 1.2, 0.7, 1.0, 2.0, 4.0, 0.7, 18.0, 2.0, 1.0, 4.0, 2.5)
"""Frequencies of the parts of ``all_courses``: many drops and deep trenches."""

_HARD: tuple[tuple[AnyTerrain, float], ...] = (
    *((part, share) for (part, _), share in zip(MIX, _SHARES, strict=True)),
    (BuildingStair(slope_low=20, slope_high=28, fewest=7, most=16, direction="down"), 10.0),
    (Midway(), 2.0),
    (PaperStair(), 1.5),
    (Plum(), 4.0),
    (Ramp(), 4.0),
)


@terrain("hard_courses")
class HardCourses(Mix):
    """``all_courses`` with more of what policies learn last, for training rather than for judging.

    That is deep trenches, drops, long and flat flights down, piles, ramps, starts on stairs and
    the paper's stair.
    """

    parts: tuple[AnyTerrain, ...] = Field(
        tuple(part for part, _ in _HARD),
        min_length=1,
        description="the terrains: names, or mappings with a name and fields [-]",
    )
    weights: tuple[float, ...] = Field(
        tuple(share for _, share in _HARD),
        description="relative frequency of each part; equal for all if empty [-]",
    )
