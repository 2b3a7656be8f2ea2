"""Mixes of everything that one policy shall drive over."""

from flipperctl.api import AnyTerrain, IntRange, Range, terrain

from .combinators import Course, Midway, Mix, parts_field, weights_field
from .obstacles import Gap, Ramp, Step, Uplift
from .rough import Rough
from .rows import Pallet, Plates, Plum, Rubble, Wave
from .stairs import BuildingStair, PaperStair, Stair, Stairwell

_STAIR = Stair(steps=IntRange(3, 6), tread=0.3, tread_down=0.25, tread_spread=0.05)
_MIX: tuple[tuple[AnyTerrain, float], ...] = (
    (Step(height=Range(-0.45, 0.45)), 1.0),
    (Step(height=Range(0.1, 0.45), platform=2.0, back=True), 1.0),
    (_STAIR, 2.0),
    (_STAIR.model_copy(update={"direction": "up", "platform": 1.5, "back": True}), 2.0),
    (BuildingStair(), 1.5),
    (BuildingStair(steps=IntRange(7, 16)), 1.0),
    (BuildingStair(steps=IntRange(8, 16), landing_every=6), 1.0),
    (Ramp(), 1.5),
    (Uplift(), 1.0),
    (Gap(), 1.5),
    (Wave(), 1.5),
    (Rubble(), 1.0),
    (Pallet(), 1.0),
    (Plum(), 2.0),
    (Plates(), 1.5),
    (Rough(longest=8.0, length=Range(4.0, 8.0)), 1.5),
)


@terrain("all_kinds")
class AllKinds(Mix):
    """One of twelve kinds of ground each episode, from steps to natural ground.

    Stairs are the most frequent: flights of 3 to 16 steps, with and without landings. One policy
    for all of it is trained with this terrain.
    """

    parts: tuple[AnyTerrain, ...] = parts_field(tuple(part for part, _ in _MIX))
    weights: tuple[float, ...] = weights_field(tuple(weight for _, weight in _MIX))


_SHORT_STAIR = BuildingStair(steps=IntRange(2, 5))
_OBSTACLES: tuple[tuple[AnyTerrain, float], ...] = (
    (Step(), 1.5),
    (_SHORT_STAIR, 2.0),
    (Ramp(), 1.0),
    (Gap(), 1.0),
    (Uplift(), 1.0),
    (Wave(waves=IntRange(2, 3)), 0.5),
    (Rubble(blocks=IntRange(4, 6)), 0.5),
    (Pallet(hurdles=IntRange(2, 3)), 1.0),
    (Plum(piles=IntRange(3, 3)), 1.0),
    (Rough(length=Range(1.5, 3.0)), 0.5),
    (Plates(plates=IntRange(1, 2)), 1.0),
)
_SLOPES: tuple[tuple[AnyTerrain, float], ...] = (
    (BuildingStair(steps=IntRange(8, 16)), 2.0),
    (Stairwell(), 1.0),
    (Ramp(slope=Range(15, 35), length=Range(2.4, 4.0)), 2.0),
    (Rough(), 1.0),
)


def _mix(parts: tuple[tuple[AnyTerrain, float], ...]) -> dict[str, tuple[object, ...]]:
    terrains, weights = zip(*parts, strict=True)
    return {"parts": terrains, "weights": weights}


MIX: tuple[tuple[AnyTerrain, float], ...] = (
    (AllKinds(), 8.0),
    (BuildingStair(steps=IntRange(7, 16)), 2.0),
    (BuildingStair(steps=IntRange(7, 16), landing_every=5), 1.0),
    (BuildingStair(slope=Range(40, 48), steps=IntRange(3, 10)), 0.5),
    (Stair(steps=IntRange(6, 12), tread_spread=0.08), 1.0),
    (Stairwell(), 2.0),
    (Step(height=Range(-0.8, -0.3)), 1.0),
    (Step(height=Range(0.3, 0.5)), 0.5),
    (Gap(width=Range(0.3, 0.75), depth=Range(0.5, 1.5)), 0.4),
    (Gap(width=Range(0.8, 1.2)), 0.4),
    (Rough(), 1.0),
    (Course(**_mix(_OBSTACLES)), 3.0),
    (Midway(terrain=Mix(**_mix(_SLOPES))), 1.5),
    (Plates(height=Range(0.2, 0.35), tilt=Range(-20, 20)), 0.8),
)


@terrain("all_courses")
class AllCourses(Mix):
    """The mix of ``all_kinds`` with what a policy meets in a real building or in rubble.

    It adds flights of up to 16 steps with landings and turns, drops, courses of two to five
    obstacles, rough ground and high thin plates. Some episodes start or finish on slopes and
    stairs.
    """

    parts: tuple[AnyTerrain, ...] = parts_field(tuple(part for part, _ in MIX))
    weights: tuple[float, ...] = weights_field(tuple(weight for _, weight in MIX))


_SHARES = (20.0, 3.0, 1.2, 0.7, 1.0, 2.0, 4.0, 0.7, 18.0, 2.0, 12.0, 4.0, 2.5, 4.0)
"""Frequencies of the parts of ``all_courses``: many drops, deep trenches and natural ground."""

_HARD: tuple[tuple[AnyTerrain, float], ...] = (
    *((part, share) for (part, _), share in zip(MIX, _SHARES, strict=True)),
    (BuildingStair(slope=Range(20, 28), steps=IntRange(7, 16), direction="down"), 10.0),
    (Midway(), 2.0),
    (PaperStair(), 1.5),
    (Plum(), 4.0),
    (Ramp(), 4.0),
)


@terrain("hard_courses")
class HardCourses(Mix):
    """``all_courses`` with more of what policies learn last, for training.

    It has more deep trenches, drops, long and flat flights down, piles, ramps, starts on stairs,
    and the paper's stair.
    """

    parts: tuple[AnyTerrain, ...] = parts_field(tuple(part for part, _ in _HARD))
    weights: tuple[float, ...] = weights_field(tuple(weight for _, weight in _HARD))
