"""Which of the surfaces that lie above each other is the ground that a robot drives on.

In: the heights at which vertical lines through places cross a mesh, or the points of a cloud above
each place. Out: the ground's height at each place [m], NaN without one.

A surface is a layer if it looks up, lies in no body and has ``headroom`` of free height above it.
The ground is the lowest layer, so that the robot drives below bridges and ceilings, or the highest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

_SAME = 1e-4
"""Faces of one place nearer than this are one sheet with two sides [m]."""
_ROUNDING = 1e-9
"""By how much free height may fall short of the headroom: 0.7 - 0.2 is less than 0.5 [m]."""
_SHARE = 0.1
"""Smallest share of a place's points that is a layer and no stray points [-]."""


@dataclass(frozen=True)
class Choice:
    """What decides between layers."""

    headroom: float
    """Free height above the ground that the robot needs [m]."""
    highest: bool
    """Take the highest layer instead of the lowest."""


@dataclass(frozen=True)
class Crossings:
    """Where vertical lines cross faces; each array is (K,)."""

    place: NDArray[np.int64]
    """Index of the vertical line [-]."""
    height: FloatArray
    """Height of the crossing [m]."""
    front: NDArray[np.bool_]
    """Whether the face looks up there."""

    def ascending(self) -> "Crossings":
        """Return the crossings by place and height; one that several faces share is one.

        The two sides of a sheet follow as its bottom and its top.
        """
        order = np.lexsort((self.height + _SAME * self.front, self.place))
        place, height, front = self.place[order], self.height[order], self.front[order]
        same = np.zeros(len(order), dtype=np.bool_)
        same[1:] = (place[1:] == place[:-1]) & (front[1:] == front[:-1])
        same[1:] &= np.abs(np.diff(height)) < _SAME
        return Crossings(place[~same], height[~same], front[~same])


@dataclass(frozen=True)
class Ground:
    """The ground at some places."""

    height: FloatArray
    """Height, (P,) [m]; NaN where there is no layer."""
    covered: NDArray[np.bool_]
    """Whether another surface lies above the lowest layer, (P,)."""
    behind: NDArray[np.bool_]
    """Whether the highest face is seen from behind from above, (P,)."""
    doubtful: NDArray[np.bool_]
    """Whether a face with room above it may lie in a body that is not closed, (P,)."""
    raised: NDArray[np.bool_]
    """Whether a surface below the ground has less than the headroom above it, (P,)."""


def ground_of_faces(crossings: Crossings, places: int, choice: Choice) -> Ground:
    """Return the ground below the faces of a mesh at each of a number of places."""
    found = crossings.ascending()
    place, height, front = found.place, found.height, found.front
    last = np.append(place[1:] != place[:-1], True)[: len(place)]
    room = np.where(last, np.inf, np.append(height[1:], 0.0)[: len(place)] - height)
    roomy = front & (room >= choice.headroom - _ROUNDING)
    depth, below = _bodies_above(found), _backs_below(found)
    # Without a face that looks down farther below, what lies above is a sheet and no body.
    inside = (depth > 0) & (below > 0)
    layer = roomy & ~inside
    result = np.full(places, -np.inf if choice.highest else np.inf)
    (np.maximum if choice.highest else np.minimum).at(result, place[layer], height[layer])
    if choice.highest:  # what is seen from behind from above is open
        top = np.full(places, -np.inf)
        np.maximum.at(top, place, height)
        result = np.where(result >= top - _SAME, result, np.nan)
    covered, behind, doubtful, raised = (np.zeros(places, np.bool_) for _ in range(4))
    covered[place[layer & ~last]] = True
    behind[place[~front & last]] = True
    doubtful[place[roomy & inside & (below < depth + 1)]] = True
    result = np.where(np.isfinite(result), result, np.nan)
    raised[place[front & ~roomy & ~inside & (height < result[place])]] = True
    return Ground(result, covered, behind, doubtful, raised)


def _bodies_above(found: Crossings) -> NDArray[np.int64]:
    """Return the number of bodies that begin above each crossing and do not end above it, (K,)."""
    step = np.where(found.front, 1, -1)[::-1]  # from above, a face that looks up begins a body
    place = found.place[::-1]
    begins = np.append(True, place[1:] != place[:-1])[: len(place)]
    group = np.cumsum(begins)
    total = np.cumsum(step)
    base = (total - step)[begins][group - 1]
    # A body ends only if it began: the sum is reflected at zero, for each place by itself.
    shift = group * (2 * len(step) + 1)
    lowest = np.minimum.accumulate(np.minimum(total, base) - shift) + shift
    after = total - lowest
    before = np.append(0, after[:-1])[: len(after)]
    before[begins] = 0
    reversed_back: NDArray[np.int64] = before[::-1]
    return reversed_back


def _backs_below(found: Crossings) -> NDArray[np.int64]:
    """Return the number of faces that look down below each crossing of its place, (K,)."""
    back = (~found.front).astype(np.int64)
    before = np.cumsum(back) - back
    begins = np.append(True, found.place[1:] != found.place[:-1])[: len(back)]
    counts: NDArray[np.int64] = before - before[begins][np.cumsum(begins) - 1]
    return counts


def layer_of_points(heights: FloatArray, choice: Choice) -> tuple[FloatArray, bool]:
    """Return the heights of one place's points, (K,) [m], that are its ground.

    Also returns whether there were several layers. Stray points are a layer of none.
    """
    ordered = np.sort(heights)
    apart = np.diff(ordered) > choice.headroom - _ROUNDING
    parts = np.split(ordered, np.flatnonzero(apart) + 1)
    layers = [part for part in parts if len(part) >= _SHARE * len(ordered)]
    return layers[-1 if choice.highest else 0], len(layers) > 1
