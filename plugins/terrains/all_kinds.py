"""All kinds of ground in one mix, stairs of up to 16 steps included."""

from pydantic import Field

from flipperctl.api import AnyTerrain, terrain

from .building_stair import BuildingStair
from .gap import Gap
from .mix import Mix
from .pallet import Pallet
from .plum import Plum
from .ramp import Ramp
from .rubble import Rubble
from .stair import Stair
from .step import Step
from .uplift import Uplift
from .wave import Wave

_STAIR = Stair(fewest=3, most=6, tread=0.3, tread_down=0.25, tread_spread=0.05)
_MIX: tuple[tuple[AnyTerrain, float], ...] = (
    (Step(low=-0.45, high=0.45), 1.0),
    (Step(low=0.1, high=0.45, platform=2.0, back=True), 1.0),
    (_STAIR, 2.0),
    (_STAIR.model_copy(update={"direction": "up", "platform": 1.5, "back": True}), 2.0),
    (BuildingStair(), 1.5),
    (BuildingStair(fewest=7, most=16), 1.0),
    (BuildingStair(fewest=8, most=16, landing_every=6), 1.0),
    (Ramp(), 1.5),
    (Uplift(), 1.0),
    (Gap(), 1.5),
    (Wave(), 1.5),
    (Rubble(), 1.0),
    (Pallet(), 1.0),
    (Plum(), 2.0),
)


@terrain("all_kinds")
class AllKinds(Mix):
    """Draw one of ten kinds of ground each episode, from steps to boards of random height.

    Stairs are the most frequent: flights of 3 to 16 steps, with and without landings. One policy
    for all of it is trained with this terrain.
    """

    parts: tuple[AnyTerrain, ...] = Field(
        tuple(part for part, _ in _MIX),
        min_length=1,
        description="the terrains: names, or mappings with a name and fields [-]",
    )
    weights: tuple[float, ...] = Field(
        tuple(weight for _, weight in _MIX),
        description="relative frequency of each part; equal for all if empty [-]",
    )
