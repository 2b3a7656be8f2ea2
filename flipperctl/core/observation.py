"""Layout of the numbers of an observation (paper Eqs. 1 and 2), and the heights of its bins.

First come the mean heights of the ground in N bins of frame L [m], from rear to front. Unless the
layout is the paper's, the heights of each bin's highest point follow. The angles of the front and
the rear flippers in frame R and the pitch are the last numbers [rad]; of four flippers, those at
the front come first, left before right. With sides, the heights below the left and then below the
right tracks follow those of the whole width, and the roll stands before the angles.

A mean hides what is thinner than its bin: it shows a seventh of a plate 2 cm thick and 0.25 m high.
Frame L is level with its origin at the chassis centre, frame R is fixed to the chassis. Unseen
ground is filled with points on straight lines between the seen points. ``sim.planar.rays`` compiles
``add_heights`` and the filling; they call no other function, so that they can be compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray

ANGLES = ("theta_f1", "theta_f2", "theta_R")
"""Names of the last angles: front flippers, rear flippers, pitch."""
FOUR = ("theta_f1_left", "theta_f1_right", "theta_f2_left", "theta_f2_right", "theta_R")
"""Names of the last angles if each flipper turns alone."""
ROLL = "roll"
"""Name of the angle before them in a layout with sides."""
SIDES = {"left_": 1.0, "right_": -1.0}
"""Prefix of the names of a side's heights → sign of its y."""
HALF_WIDTH = 0.36
"""Ground within this distance beside the robot's line is below its tracks [m]."""


def heights(bins: int, highest: bool, sides: bool = False) -> int:
    """Return the number of heights in an observation: N, or 2 N with the ``highest`` points [-].

    With ``sides``, there are as many again for each.
    """
    return bins * (2 if highest else 1) * (1 + sides * len(SIDES))


def angles(sides: bool = False, joints: int = 2) -> tuple[str, ...]:
    """Return the names of the angles after the heights, of 2 or 4 joints."""
    names = ANGLES if joints == 2 else FOUR
    return (ROLL, *names) if sides else names


def reach(bins: int, bin_width: float) -> float:
    """Return half the length of the perceived ground [m]."""
    return bins * bin_width / 2


def edges(bins: int, bin_width: float) -> FloatArray:
    """Return the edges of the bins in frame L, from rear to front, (N + 1,) [m]."""
    return np.arange(bins + 1, dtype=np.float64) * bin_width - reach(bins, bin_width)


def scale(heights: int, angles: int = 3) -> FloatArray:
    """Return the typical magnitudes of so many heights and angles, in SI units."""
    return np.concatenate([np.full(heights, 0.5), np.full(angles, math.pi / 3)])


def assemble(
    heights: FloatArray, flippers: Sequence[float], *, pitch: float, roll: float | None = None
) -> NDArray[np.float32]:
    """Return an observation, (n,) in SI units.

    ``heights``: the result of ``bin_heights``; ``flippers``: angles of the joints in frame R, above
    the chassis positive, (J,) [rad]; ``pitch``: nose up positive; ``roll``: left side up positive
    [rad], None in a layout without sides.
    """
    numbers = (*flippers, pitch) if roll is None else (roll, *flippers, pitch)
    observation = np.empty(len(heights) + len(numbers), dtype=np.float32)
    observation[: len(heights)], observation[len(heights) :] = heights, numbers
    return observation


def to_level(points: FloatArray, pitch: float) -> FloatArray:
    """Transform points (P, 2) [m] from frame R to frame L at this pitch [rad]."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    x, z = points.T
    return np.column_stack([cos * x - sin * z, sin * x + cos * z])


def add_heights(points: FloatArray, behind: float, width: float, heights: FloatArray) -> int:
    """Fill in the mean and the highest height of each bin's points; return how many bins have any.

    ``points`` are (P, 2) in frame L; the first bin begins ``behind`` the chassis centre, and a bin
    is ``width`` long [m]. ``heights`` are (2, N); those of a bin without points become infinite.
    """
    heights[0], heights[1] = 0.0, -math.inf
    count = np.zeros(heights.shape[1])
    for i in range(len(points)):
        # A point on the front border may round into a bin past the last one.
        index = min(int((points[i, 0] + behind) / width), len(count) - 1)
        count[index] += 1
        heights[0, index] += points[i, 1]
        heights[1, index] = max(heights[1, index], points[i, 1])
    seen = 0
    for index in range(len(count)):
        if count[index] > 0:
            heights[0, index] /= count[index]
            seen += 1
    return seen


Add = Callable[[FloatArray, float, float, FloatArray], int]
"""A function like ``add_heights``."""


def bin_heights(
    points: FloatArray,
    bins: int,
    bin_width: float,
    *,
    highest: bool,
    add_heights: Add = add_heights,
) -> FloatArray:
    """Return the mean height of each bin's points, rear to front, in frame L, (N,) [m].

    With ``highest``, the heights of each bin's highest point follow, (2 N,).
    ``points``: (P, 2) in frame L within ``reach`` [m], in any order. Heights of an
    empty bin are interpolated linearly between its neighbours; beyond the outermost bins with
    points they equal theirs. Without any points, every height is 0. ``add_heights``
    may be a compiled one.
    """
    both = np.empty((2, bins))  # mean and highest
    seen = add_heights(points, reach(bins, bin_width), bin_width, both)
    if not seen:
        both[:] = 0.0
    elif seen < bins:
        where = np.flatnonzero(np.isfinite(both[1]))
        both = np.array([np.interp(np.arange(bins), where, row[where]) for row in both])
    return both.ravel() if highest else both[0]


def occupied(points: FloatArray, bins: int, bin_width: float) -> NDArray[np.bool_]:
    """Return which bins have points, (N,); ``points`` are (P, 2) as for ``bin_heights`` [m]."""
    index = (points[:, 0] + reach(bins, bin_width)) / bin_width
    seen = np.zeros(bins, np.bool_)
    seen[np.clip(index.astype(np.int64), 0, bins - 1)] = True
    return seen


def fill_gaps(
    points: FloatArray,
    index: NDArray[np.int64],
    offered: NDArray[np.bool_],
    spacing: float,
    limits: tuple[float, float],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the offered points with the gaps filled, (P', 2) [m], and which of them are filled.

    ``points`` (P, 2) are the seen points in order along the ground; ``index`` (P,) are their
    numbers along it, with gaps where the ground is unseen. A gap is filled with points at most
    ``spacing`` [m] apart on the straight line between both neighbours. Before the first and past
    the last point, the ground is level up to the ``limits`` of x [m]. ``offered`` (P,): whether a
    seen point is returned.
    """
    low, high = limits
    if len(points) == 0:
        return np.empty((0, 2)), np.empty(0, dtype=np.bool_)
    # Level ground leads from the first and the last point to the limits.
    ends = np.empty((len(points) + 2, 2))
    ends[1:-1] = points
    ends[0, 0], ends[0, 1] = min(low, points[0, 0]), points[0, 1]
    ends[-1, 0], ends[-1, 1] = max(high, points[-1, 0]), points[-1, 1]
    # A gap takes as many points as keep its neighbours within the spacing.
    counts = np.zeros(len(points) + 1, dtype=np.int64)  # filled points before each seen one
    for i in range(len(counts)):
        if 0 < i < len(points) and index[i] == index[i - 1] + 1:
            continue
        length = math.hypot(ends[i + 1, 0] - ends[i, 0], ends[i + 1, 1] - ends[i, 1])
        counts[i] = max(0, math.ceil(length / spacing - 1e-9) - 1)
    # Gaps and offered points alternate, in order along the ground.
    most = counts.sum() + len(points)
    result, filled = np.empty((most, 2)), np.zeros(most, dtype=np.bool_)
    n = 0
    for i in range(len(counts)):
        for k in range(1, counts[i] + 1):
            share = k / (counts[i] + 1)
            x = ends[i, 0] + share * (ends[i + 1, 0] - ends[i, 0])
            if low <= x < high:
                result[n, 0] = x
                result[n, 1] = ends[i, 1] + share * (ends[i + 1, 1] - ends[i, 1])
                filled[n] = True
                n += 1
        if i < len(points) and offered[i]:
            result[n] = points[i]
            n += 1
    return result[:n].copy(), filled[:n].copy()
