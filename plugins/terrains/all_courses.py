"""Everything that one policy shall drive over: all kinds, long flights, courses, rough ground."""

from pydantic import Field

from flipperctl.api import AnyTerrain, terrain

from .all_kinds import AllKinds
from .building_stair import BuildingStair
from .course import Course
from .gap import Gap
from .midway import Midway
from .mix import Mix
from .pallet import Pallet
from .plum import Plum
from .ramp import Ramp
from .rough import Rough
from .rubble import Rubble
from .stair import Stair
from .stairwell import Stairwell
from .step import Step
from .uplift import Uplift
from .wave import Wave

_SHORT_STAIR = BuildingStair(fewest=2, most=5)
_OBSTACLES: tuple[tuple[AnyTerrain, float], ...] = (
    (Step(), 1.5),
    (_SHORT_STAIR, 2.0),
    (Ramp(), 1.0),
    (Gap(), 1.0),
    (Uplift(), 1.0),
    (Wave(most=3), 0.5),
    (Rubble(most=6), 0.5),
    (Pallet(most=3), 1.0),
    (Plum(most=3), 1.0),
    (Rough(length_low=1.5, length_high=3.0), 0.5),
)
_SLOPES: tuple[tuple[AnyTerrain, float], ...] = (
    (BuildingStair(fewest=8, most=16), 2.0),
    (Stairwell(), 1.0),
    (Ramp(slope_low=15, length_low=2.4, length_high=4.0), 2.0),
    (Rough(), 1.0),
)


def _mix(parts: tuple[tuple[AnyTerrain, float], ...]) -> dict[str, tuple[object, ...]]:
    terrains, weights = zip(*parts, strict=True)
    return {"parts": terrains, "weights": weights}


MIX: tuple[tuple[AnyTerrain, float], ...] = (
    (AllKinds(), 8.0),
    (BuildingStair(fewest=7, most=16), 2.0),
    (BuildingStair(fewest=7, most=16, landing_every=5), 1.0),
    (BuildingStair(slope_low=40, slope_high=48, fewest=3, most=10), 0.5),
    (Stair(fewest=6, most=12, tread_spread=0.08), 1.0),
    (Stairwell(), 2.0),
    (Step(low=-0.8, high=-0.3), 1.0),
    (Step(low=0.3, high=0.5), 0.5),
    (Gap(width_low=0.3, width_high=0.75, depth_low=0.5, depth_high=1.5), 0.4),
    (Gap(width_low=0.8, width_high=1.2), 0.4),
    (Rough(), 1.0),
    (Course(**_mix(_OBSTACLES)), 3.0),
    (Midway(terrain=Mix(**_mix(_SLOPES))), 1.5),
)


@terrain("all_courses")
class AllCourses(Mix):
    """The mix of ``all_kinds`` with what a policy meets in a real building or in rubble.

    That is flights of up to 16 steps with landings and turns, drops, courses of two to five
    obstacles, rough ground, and starts and finishes on slopes and stairs.
    """

    parts: tuple[AnyTerrain, ...] = Field(
        tuple(part for part, _ in MIX),
        min_length=1,
        description="the terrains: names, or mappings with a name and fields [-]",
    )
    weights: tuple[float, ...] = Field(
        tuple(weight for _, weight in MIX),
        description="relative frequency of each part; equal for all if empty [-]",
    )
