"""Choose the ground that a robot drives on among surfaces that lie above each other.

In: the heights at which vertical lines through places cross a mesh, or the points of a cloud above
each place. Out: the ground's height at each place [m], NaN without one.

A surface is a layer if it looks up, lies in no body and has ``headroom`` of free height above it.
The ground is the lowest layer, so that the robot drives below bridges and ceilings, or the highest.
A ceiling over a small hole in the floor is no ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

_SAME = 1e-4
"""Distance below which faces of one place are the two sides of one sheet [m]."""
_ROUNDING = 1e-9
"""Allowed shortfall of free height from the headroom, since 0.7 - 0.2 rounds below 0.5 [m]."""
_CEILING = 0.05
"""Height by which a ceiling may lie lower over a hole than beside it [m]."""
_FLAT = 0.01
"""Height above a surface in which no robot has room, as below a sticker on a board [m]."""
_PART = 0.25
"""Smallest number of bodies that is no rounding; on edges there are halves [-]."""
_TALL = 0.25
"""Smallest share of the headroom that the points of one place of a wall extend upwards [-]."""
_SHARE = 0.1
"""Smallest share of a place's points that counts as a layer; fewer are stray points [-]."""


@dataclass(frozen=True)
class Choice:
    """The rule that chooses the ground among layers."""

    headroom: float
    """Free height above the ground that the robot needs [m]."""
    highest: bool
    """Take the highest layer instead of the lowest."""
    largest_gap: float = 0.0
    """Longest distance along the line over which the floor below a ceiling may be missing [m]."""


@dataclass(frozen=True)
class Crossings:
    """Crossings of vertical lines with faces; each array is (K,)."""

    place: NDArray[np.int64]
    """Index of the vertical line [-]."""
    height: FloatArray
    """Height of the crossing [m]."""
    front: NDArray[np.bool_]
    """Whether the face looks up there."""

    surface: NDArray[np.int64] | None = None
    """Number of the surface that the face belongs to, -1 if to none; None: all belong to one."""
    share: FloatArray | None = None
    """Number of layers that cross [-]: 0.5 on the edge of a face; None: 1 each."""

    def ascending(self) -> "Crossings":
        """Return the crossings sorted by place and height; coinciding faces are merged.

        The two sides of a sheet are its bottom and then its top. Only faces of one surface are
        merged, and their shares added.
        """
        # Faces of one place, surface and side follow each other.
        surface = np.zeros_like(self.place) if self.surface is None else self.surface
        share = np.ones(len(self.place)) if self.share is None else self.share
        height = self.height + _SAME * self.front
        order = np.lexsort((height, surface, self.place))
        keys = np.column_stack([self.place, surface, self.front])[order]
        differs = np.append(True, (keys[1:] != keys[:-1]).any(axis=1))[: len(order)]
        differs[1:] |= np.abs(np.diff(self.height[order])) >= _SAME

        # One crossing for each such group, with all its shares
        first = np.flatnonzero(differs)
        if len(first):
            share = np.add.reduceat(share[order], first)
        order = order[first]
        up = np.lexsort((height[order], self.place[order]))
        order = order[up]
        return Crossings(
            self.place[order], self.height[order], self.front[order], surface[order], share[up]
        )

    def in_bodies(self) -> "Crossings":
        """Return the crossings, ascending, with -1 for surfaces that bound no body at their place.

        A surface bounds bodies where, from below, a face that looks up ends each body that one that
        looks down began.
        """
        crossings = self.ascending()
        assert crossings.surface is not None
        # From below within each place and surface, bodies begin and end.
        order = np.lexsort((np.arange(len(crossings.place)), crossings.surface, crossings.place))
        keys = np.column_stack([crossings.place, crossings.surface])[order]
        begins = np.append(True, (keys[1:] != keys[:-1]).any(axis=1))[: len(order)]
        bodies = crossings._bodies(order, begins)

        # A surface with a body that does not begin or end bounds none there.
        last = np.append(begins[1:], True)[: len(order)]
        group = np.cumsum(begins) - 1
        faults = np.bincount(group, (bodies < -_PART) | (last & (bodies > _PART)))
        surface = crossings.surface.copy()
        surface[order[faults[group] > 0]] = -1
        return replace(crossings, surface=surface).ascending()

    def enclosed(self) -> NDArray[np.bool_]:
        """Return whether each of the crossings ``in_bodies`` lies in a surface's body, (K,)."""
        assert self.surface is not None
        assert self.share is not None
        # Only surfaces that bound bodies count.
        bounding = replace(self, share=self.share * (self.surface != -1))
        begins = np.append(True, self.place[1:] != self.place[:-1])[: len(self.place)]
        return bounding._bodies(np.arange(len(self.place)), begins) > _PART

    def _bodies(self, order: NDArray[np.int64], begins: NDArray[np.bool_]) -> FloatArray:
        """Return the number of bodies above each crossing that begin at it or below, (K,).

        It is counted in each group of the ``order``, (K,), from where the group ``begins``, (K,).
        """
        assert self.share is not None
        step = np.where(self.front, -self.share, self.share)[order]
        total = np.cumsum(step)
        bodies: FloatArray = total - (total - step)[begins][np.cumsum(begins) - 1]
        return bodies


@dataclass(frozen=True)
class Ground:
    """The ground at some places."""

    height: FloatArray
    """Height, (P,) [m]; NaN where there is no layer."""
    covered: NDArray[np.bool_]
    """Whether another surface lies above the lowest layer, (P,)."""
    behind: NDArray[np.bool_]
    """Whether the highest face looks down, so that its back is seen from above, (P,)."""
    doubtful: NDArray[np.bool_]
    """Whether a face with room above it may lie in a body that is not closed, (P,)."""
    raised: NDArray[np.bool_]
    """Whether a surface below the ground has less than the headroom above it, (P,)."""
    above: FloatArray
    """Height of what lies above the lowest layer, (P,) [m]; infinite where nothing does."""
    underside: FloatArray
    """Lowest height of the body or sheet that is the ground, (P,) [m].

    It is -inf where another surface that looks up lies below.
    """

    def without_ceilings_over_holes(self, along: FloatArray, choice: Choice) -> "Ground":
        """Return the ground with NaN where a ceiling lies over a small hole in the floor.

        Places are a grid (A, L), numbered row by row, at the distances ``along``, (A,) [m]. A hole
        lies between two places below the same ceiling.
        """
        if choice.highest or choice.largest_gap == 0:
            return self
        # Each row of the grid along the line is searched by itself.
        grid = (len(along), -1)
        height, above, underside = (
            values.reshape(grid).T.copy() for values in (self.height, self.above, self.underside)
        )
        for column in range(len(height)):
            for hole in _holes(height[column], above[column], underside[column], along, choice):
                height[column, hole] = np.nan
        return replace(self, height=height.T.ravel())


def _holes(
    height: FloatArray, above: FloatArray, underside: FloatArray, along: FloatArray, choice: Choice
) -> Iterator[slice]:
    """Yield the holes of a row, (A,): places below only the ceiling that both neighbours have."""
    # Holes begin where the floor does, and end at the next floor below the same ceiling.
    known = np.isfinite(height)
    floor = known & np.isfinite(above)
    # A place below a ceiling is followed by that ceiling, or by places without any face.
    begins = floor[:-1] & (~known[1:] | (underside[1:] >= above[:-1] - _CEILING))
    for before in np.flatnonzero(begins):
        lowest = above[before] - _CEILING
        after = int(before) + 1
        while after < len(height) and (not known[after] or underside[after] >= lowest):
            after += 1
        if after == len(height) or not floor[after]:
            continue
        hole = slice(int(before) + 1, after)
        lowest = max(height[before], height[after]) + choice.headroom - _ROUNDING
        lowest = max(lowest, min(above[before], above[after]) - _CEILING)
        narrow = along[after] - along[before] <= choice.largest_gap
        if narrow and (underside[hole][known[hole]] >= lowest).all():
            yield hole


def ground_of_faces(crossings: Crossings, places: int, choice: Choice) -> Ground:
    """Return the ground below the faces of a mesh at each of a number of places.

    A surface that is closed above a place bounds bodies there, whatever lies above or below it.
    The faces of all other surfaces may together bound a body, as loose faces do.
    """
    bounded = crossings.in_bodies()
    place, height, front = bounded.place, bounded.height, bounded.front
    # Room above each crossing, and bodies that it lies in
    last = np.append(place[1:] != place[:-1], True)[: len(place)]
    room = np.where(last, np.inf, np.append(height[1:], 0.0)[: len(place)] - height)
    roomy = front & (room >= choice.headroom - _ROUNDING)
    assert bounded.surface is not None
    is_loose, enclosed = bounded.surface == -1, bounded.enclosed()
    depth, below = _bodies_above(bounded, is_loose), _backs_below(bounded, is_loose)
    # Without a loose face that looks down farther below, what lies above is a sheet and no body.
    inside = enclosed | ((depth > 0) & (below > 0))
    layer = roomy & ~inside

    # The lowest layer of each place, or the highest
    result = np.full(places, -np.inf if choice.highest else np.inf)
    (np.maximum if choice.highest else np.minimum).at(result, place[layer], height[layer])
    if choice.highest:  # a place whose top shows its back is open
        top = np.full(places, -np.inf)
        np.maximum.at(top, place, height)
        result = np.where(result >= top - _SAME, result, np.nan)

    # What the caller should know of each place
    covered, behind, doubtful, raised = (np.zeros(places, np.bool_) for _ in range(4))
    covered[place[layer & ~last]] = True
    behind[place[~front & last]] = True
    doubtful[place[roomy & inside & ~enclosed & (below < depth + 1)]] = True
    result = np.where(np.isfinite(result), result, np.nan)

    # What lies above, what too little room left, and how far down the ground reaches
    above = np.full(places, np.inf)
    lowest = layer & (height == result[place]) & ~last
    above[place[lowest]] = np.append(height[1:], 0.0)[: len(place)][lowest]
    raised[place[front & ~roomy & ~inside & (height < result[place] - _FLAT)]] = True
    underside = _undersides(bounded, result)
    return Ground(result, covered, behind, doubtful, raised, above, underside)


def _undersides(crossings: Crossings, ground: FloatArray) -> FloatArray:
    """Return ``Ground.underside``, (P,), of the ground's heights (P,) [m]."""
    place, height, front = crossings.place, crossings.height, crossings.front
    result = ground.copy()
    below = height < ground[place] - _SAME * front  # not where two surfaces coincide
    result[place[below & ~front]] = height[below & ~front]  # the last is the highest of a place
    result[place[below & front]] = -np.inf
    return result


def _bodies_above(crossings: Crossings, counted: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number of bodies that begin above each crossing and do not end above it, (K,).

    Only crossings that are ``counted``, (K,), begin and end bodies.
    """
    step = (counted * np.where(crossings.front, 1, -1))[
        ::-1
    ]  # from above, one that looks up begins
    place = crossings.place[::-1]
    begins = np.append(True, place[1:] != place[:-1])[: len(place)]
    group = np.cumsum(begins)
    total = np.cumsum(step)
    base: NDArray[np.int64] = (total - step)[begins][group - 1]
    # A body ends only if it began: the sum is reflected at zero, separately for each place.
    shift = group * (2 * len(step) + 1)
    lowest = np.minimum.accumulate(np.minimum(total, base) - shift) + shift
    after = total - lowest
    before = np.append(0, after[:-1])[: len(after)]
    before[begins] = 0
    reversed_back: NDArray[np.int64] = before[::-1]
    return reversed_back


def _backs_below(crossings: Crossings, counted: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number of ``counted`` faces that look down below each crossing, (K,)."""
    back = (counted & ~crossings.front).astype(np.int64)
    before = np.cumsum(back) - back
    begins = np.append(True, crossings.place[1:] != crossings.place[:-1])[: len(back)]
    counts: NDArray[np.int64] = before - before[begins][np.cumsum(begins) - 1]
    return counts


def overhead(ground: Ground, along: FloatArray, choice: Choice, margin: float) -> NDArray[np.bool_]:
    """Return at which places, (P,), only something above an unseen floor was measured.

    ``along`` are the distances of the places, ascending (P,) [m], and the ground is of points.
    A run of places hangs if it begins ``headroom`` or more above the places on both sides of it,
    without points between, or on the one side where the line ends. Such a run is

    - overhead if something at its height lies above the ground more than the ``margin`` [m] away
      from it; nearer, the place may hold points on both sides of a wall's edge,
    - ground if another part of the ground is as high, such as the far side of a trench,
    - overhead if it has gaps to its sides, or is at an end of the line and not tall,
    - else ground: the top of a wall, seen from above, which hides just the floor below it, or a
      wall at the end, whose lower part is hidden.

    Runs that reach over more than ``largest_gap`` are ground.
    """
    result = np.zeros(len(along), np.bool_)
    if choice.highest or choice.largest_gap == 0:
        return result
    # One run after the other, until none is left that hangs
    is_ground = np.zeros(len(along), np.bool_)  # hanging runs that are ground
    known = np.flatnonzero(np.isfinite(ground.height))
    usual = 2 * float(np.median(np.diff(along[known]))) if len(known) > 1 else 0.0
    while (run := _hanging(ground, known[~result[known]], along, choice, is_ground)) is not None:
        places, before, after = run

        # Whether the run has gaps to its sides, or at an end of the line is not tall
        level = float(np.median(ground.underside[places]))
        near = choice.headroom / 2
        others = np.setdiff1d(known, places)
        if len(before) and len(after):
            apart = np.diff(np.concatenate([along[before], along[places], along[after]])).max()
            alone = apart > usual + _ROUNDING
        else:
            tall = (ground.height - ground.underside)[places].max()
            alone = tall < choice.headroom * _TALL

        # Whether its height is found elsewhere: over the ground, or as ground
        away = along[others] < along[places[0]] - margin
        away |= along[others] > along[places[-1]] + margin
        hides = (away & (np.abs(ground.above[others] - level) <= near)).any()
        rises = (np.abs(ground.height[others] - level) <= near) & ~result[others]
        hangs = hides or (alone and not rises.any())
        (result if hangs else is_ground)[places] = True
    return result


def _hanging(
    ground: Ground,
    known: NDArray[np.int64],
    along: FloatArray,
    choice: Choice,
    is_ground: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the places of a run that hangs, with one before and one after it where there is one.

    Runs are parts of the ``known`` places, those ``kept`` are left out. None if there is no other.
    """
    # Runs of places, cut where the headroom lies between neighbours
    room = choice.headroom - _ROUNDING
    low, high = ground.underside[known], ground.height[known]
    cuts = (low[1:] >= high[:-1] + room) | (low[:-1] >= high[1:] + room)
    runs = np.split(known, np.flatnonzero(cuts) + 1)
    for number, run in enumerate(runs):
        before = runs[number - 1][-1:] if number else run[:0]
        after = runs[number + 1][:1] if number + 1 < len(runs) else run[:0]
        sides = np.concatenate([before, after])
        if not len(sides) or is_ground[run].any():
            continue
        begin = along[before[0]] if len(before) else along[0]
        end = along[after[0]] if len(after) else along[-1]
        hangs = ground.underside[run].min() >= ground.height[sides].max() + room
        if hangs and end - begin <= choice.largest_gap:
            return run, before, after
    return None


def parts_of_points(heights: FloatArray, choice: Choice) -> list[FloatArray]:
    """Return the heights of one place's points, (K,) [m], split where the headroom is free."""
    ordered = np.sort(heights)
    apart = np.diff(ordered) > choice.headroom - _ROUNDING
    return np.split(ordered, np.flatnonzero(apart) + 1)


def layer_of_points(heights: FloatArray, choice: Choice) -> tuple[FloatArray, float]:
    """Return the heights of one place's points, (K,) [m], that are its ground.

    Also returns the height of what lies above the lowest layer, which is infinite if nothing does.
    Stray points belong to no layer.
    """
    parts = parts_of_points(heights, choice)
    layers = [part for part in parts if len(part) >= _SHARE * len(heights)]
    above = float(layers[1][0]) if len(layers) > 1 else np.inf
    return layers[-1 if choice.highest else 0], above
