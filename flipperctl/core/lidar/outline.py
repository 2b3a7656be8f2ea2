"""The ground in the robot's side plane, from the points of a map, and how far it may err.

In: level points around the robot. Out: a polyline with vertical faces, points along it, and a
standard deviation of the height of each bin.

The points are sorted into columns. Where the heights of a column spread more than noise and slope
explain, a riser stands in it; neighbouring columns of this kind become one vertical face. Their
medians would make it a ramp, which a robot climbs differently.

The errors of single points do not count, since their mean over a bin errs by less than a
millimetre. The pose of a scan errs: by its tilt, with the distance, and by odometry, with the way
since the ground was seen. It errs along the way too, which moves edges into other bins. Where
ground was not seen, what fills it may be anywhere between the levels on both sides, or deeper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray, observation

_SPREAD = 2.6  # spread of a level column's heights between their 10 % and 90 % quantiles, in σ [-]
_SLOPE = 1.5  # rise of a steep slope within a column, in lengths of the column [-]
_APART = 2.5  # columns this far apart are not neighbours, in lengths of the column [-]
_FACE = 0.2
"""Fraction of a face's height at either end whose points do not tell where it stands [-]."""
_HIDDEN = 0.7  # slope of a fall through unseen ground from which an edge hides it [-]

_INDEX, _HEIGHT, _QUANTUM = 20, 26, 1e-5
"""Bits of a point's index and of its height in a key for sorting [-]; unit of the height [m]."""


@dataclass(frozen=True)
class Columns:
    """The points of the map by columns along x, those without enough points left out."""

    x: FloatArray  # (C,) middle of each column [m]
    median: FloatArray  # (C,) median height [m]
    low: FloatArray  # (C,) 10 % quantile of the heights [m]
    high: FloatArray  # (C,) 90 % quantile of the heights [m]
    begin: NDArray[np.int64]  # (C,) index of each column's first point in ``points``
    end: NDArray[np.int64]  # (C,) index past each column's last point in ``points``
    points: FloatArray  # (P, 2) x and z of the points, by column, then by height [m]
    cell: float  # length of a column [m]


def sorted_points(points: FloatArray, cell: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Sort ``points`` (P, 3) [m] by column of the length ``cell`` [m] along x, then by height.

    Return the number of each point's column, (P,), and the points.
    """
    number = np.floor(points[:, 0] / cell).astype(np.int64)
    if len(points) and len(points) < 1 << _INDEX:
        # Column, height and index in one integer: numpy sorts integers several times faster than
        # it sorts indices by two keys.
        height = np.clip(points[:, 2] / _QUANTUM, -(1 << _HEIGHT - 1), (1 << _HEIGHT - 1) - 1)
        key = ((number - number.min()) << _HEIGHT) + height.astype(np.int64) + (1 << _HEIGHT - 1)
        order = np.sort((key << _INDEX) + np.arange(len(points))) & ((1 << _INDEX) - 1)
    else:
        order = np.lexsort((points[:, 2], number))
    return number[order], points.take(order, axis=0)


def columns(points: FloatArray, cell: float, fewest: int) -> Columns:
    """Return the columns of ``points`` (P, 3) [m] with at least ``fewest`` of them.

    ``cell``: the length of a column [m].
    """
    # Each column's points in a row
    number, ordered = sorted_points(points, cell)
    ordered = ordered[:, [0, 2]]
    changes = np.flatnonzero(np.diff(number)) + 1
    begin = np.concatenate([[0], changes]).astype(np.int64)
    end = np.concatenate([changes, [len(number)]]).astype(np.int64)  # one empty column if no points
    enough = end - begin >= max(1, fewest)
    begin, end = begin[enough], end[enough]
    z, count = ordered[:, 1], end - begin
    return Columns(
        x=np.asarray((number[begin] + 0.5) * cell, np.float64),
        median=z[begin + count // 2],
        low=z[begin + count // 10],
        high=z[end - 1 - count // 10],
        begin=begin,
        end=end,
        points=ordered,
        cell=cell,
    )


def polyline(columns: Columns, noise: float) -> FloatArray:
    """Return the ground as a polyline with vertical faces, x never decreasing, (V, 2) [m].

    ``noise``: standard deviation of the heights of points on level ground [m].
    """
    # Neighbouring steep columns are one face.
    steep = columns.high - columns.low > _SPREAD * noise + _SLOPE * columns.cell
    near = np.diff(columns.x) < _APART * columns.cell
    line: list[tuple[float, float]] = []
    i, count = 0, len(columns.x)
    while i < count:
        j = i
        while steep[i] and j + 1 < count and steep[j + 1] and near[j]:
            j += 1
        if steep[i]:
            before = float(columns.median[i - 1]) if i and near[i - 1] else None
            after = float(columns.median[j + 1]) if j + 1 < count and near[j] else None
            line += _face(columns, i, j, before, after)
        else:
            line.append((float(columns.x[i]), float(columns.median[i])))
        i = j + 1
    vertices = np.array(line).reshape(-1, 2)
    vertices[:, 0] = np.maximum.accumulate(vertices[:, 0])
    return vertices


def _face(
    columns: Columns, first: int, last: int, before: float | None, after: float | None
) -> list[tuple[float, float]]:
    """Return the vertices of the steep columns ``first`` to ``last``.

    ``before`` and ``after`` are the heights of the ground on either side, None where unseen [m].
    A face that falls away from the robot cannot be seen. What seems to be one beside unseen ground
    is mixed returns, and one between seen ground stands at its beginning.
    """
    low, high = (
        float(columns.low[first : last + 1].min()),
        float(columns.high[first : last + 1].max()),
    )
    middle = (low + high) / 2
    # Beside unseen ground only a face that rises counts; a fall would be mixed returns.
    if before is None:
        if after is not None and after <= middle:
            return []
        before = low
    if after is None:
        if before > middle:
            return []
        after = high

    if abs(after - before) <= (high - low) / 2:  # a narrow ridge or trench, or an oblique edge
        run = slice(first, last + 1)
        return list(zip(columns.x[run].tolist(), columns.median[run].tolist(), strict=True))
    # A fall that is wider than a face hides its foot: it stands at its edge.
    falls = after < before and last > first + 1  # wider than a face: mixed returns behind its edge
    x = _face_position(columns, first, first + 1 if falls else last, before, after)
    return [(x, before), (x, after)]


def _face_position(columns: Columns, first: int, last: int, before: float, after: float) -> float:
    """Return where the face between two levels stands: the mean x of its points [m]."""
    points = columns.points[columns.begin[first] : columns.end[last]]
    # Points of the face itself, if there are some
    share = (points[:, 1] - before) / (after - before)
    on_face = points[(share > _FACE) & (share < 1 - _FACE), 0]
    if len(on_face) >= 3:
        return float(on_face.mean())

    # Otherwise by how far the columns' medians have passed from one level to the other
    passed = np.clip((columns.median[first : last + 1] - after) / (before - after), 0.0, 1.0)
    start = float(columns.x[first]) - columns.cell / 2
    width = float(columns.x[last]) + columns.cell / 2 - start
    return start + width * float(passed.mean())


def with_assumed(
    line: FloatArray, assumed: FloatArray, gap: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the polyline with ``assumed`` vertices where it has gaps, and which are assumed.

    An assumed vertex, (A, 2), is taken if no vertex of ``line`` lies within ``gap`` of it [m].
    """
    if len(line):
        # Assumed vertices near seen ones are left out.
        right = np.searchsorted(line[:, 0], assumed[:, 0])
        distances = [
            np.abs(line[np.clip(right + shift, 0, len(line) - 1), 0] - assumed[:, 0])
            for shift in (-1, 0)
        ]
        assumed = assumed[np.minimum(*distances) > gap]

    # The rest is merged by place.
    both = np.concatenate([line, assumed])
    flags = np.arange(len(both)) >= len(line)
    order = np.argsort(both[:, 0], kind="stable")  # keeps the order within a face
    return both[order], flags[order]


def with_drops(
    line: FloatArray, assumed: NDArray[np.bool_], gap: float, half: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the polyline with a vertical face below each edge that hides the ground behind it.

    A LiDAR above the ground sees nothing in the shadow of an edge. A straight line through it would
    be as high as the ground can be at all; most often it falls at the edge. The face stands
    ``half`` a column past the last one seen [m], is assumed, and so is what lies behind it.
    """
    # Steep falls through unseen ground, between seen vertices
    step = np.diff(line, axis=0)
    steep = -step[:, 1] > _HIDDEN * step[:, 0]
    drops = np.flatnonzero((step[:, 0] > gap) & steep & ~assumed[:-1] & ~assumed[1:])
    edge = line[drops, 0] + half

    # Each becomes a face at its edge.
    faces = np.empty((2 * len(drops), 2))
    faces[0::2] = np.column_stack([edge, line[drops, 1]])
    faces[1::2] = np.column_stack([edge, line[drops + 1, 1]])
    at = np.repeat(drops + 1, 2)
    flags = np.insert(assumed, at, np.tile([False, True], len(drops)))
    return np.insert(line, at, faces, axis=0), flags


def points_along(
    line: FloatArray,
    assumed: NDArray[np.bool_],
    spacing: float,
    gap: float,
    limits: tuple[float, float],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return points along the polyline, (P, 2) [m], and which of them fill unseen ground.

    They are ``spacing`` apart, and include both ends of each face. Parts longer than ``gap`` along
    x or beside an ``assumed`` vertex were not seen; beyond its ends, the line goes on level.
    ``limits``: range of x [m].
    """
    low, high = limits
    if not len(line):
        return np.zeros((0, 2)), np.zeros(0, np.bool_)
    # The line goes on level to both limits, which nobody has seen.
    ends = np.array([[min(low, line[0, 0]), line[0, 1]], [max(high, line[-1, 0]), line[-1, 1]]])
    line = np.concatenate([ends[:1], line, ends[1:]])
    assumed = np.concatenate([[True], assumed, [True]])

    # Which parts were not seen, and the way along the line
    step = np.diff(line, axis=0)
    unseen = (step[:, 0] > gap) | assumed[:-1] | assumed[1:]
    length = np.hypot(step[:, 0], step[:, 1])
    along = np.concatenate([[0.0], np.cumsum(length)])
    upright = np.flatnonzero((step[:, 0] == 0) & (length > 0))

    # Points at equal distances, and both ends of each face
    regular = np.arange(0.0, along[-1], spacing)
    part = np.clip(np.searchsorted(along, regular, side="right") - 1, 0, len(step) - 1)
    part = np.concatenate([part, upright, upright])
    at = np.concatenate([regular, along[upright], along[upright + 1]])
    share = (at - along[part]) / np.maximum(length[part], 1e-12)
    points = line[part] + share[:, None] * step[part]

    # In the order along the line
    order = np.argsort(at, kind="stable")
    points, filled = points[order], unseen[part][order]
    points[:, 0] = np.maximum.accumulate(points[:, 0])  # rounding
    inside = (points[:, 0] >= low) & (points[:, 0] < high)
    return points[inside], filled[inside]


_DRIFT = {"belts": 0.15, "matched": 0.02}
"""Standard deviation of the motion by odometry, per way, over the kinds of ground that
``python -m benchmarks.odometry`` drives on [-]."""


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of what makes heights err."""

    height: float = 0.004
    """Of all heights, from biased distances and points that are no ground [m]."""
    along: float = 0.012
    """Of the place of edges along the way, half a cell of the map [m]."""
    tilt: float = 0.0
    """Of roll and pitch [rad]."""
    drift: float = 0.0
    """Of the odometry, per way [-]."""
    climb: float = 0.3
    """Of the height by odometry, in parts of ``drift``, since scans correct it [-]."""
    filled: float = 0.3
    """Of filled ground, per length that is filled; the slope from an edge to what lies unseen
    behind it [-]."""


def accuracy_of(pose: str, range_bias: float, tilt: float) -> Accuracy:
    """Return the accuracy with odometry by ``pose``, ``true``, ``belts`` or ``matched``.

    ``range_bias``: largest constant error of the distances [m]; ``tilt``: standard deviation of
    roll and pitch [rad].
    """
    height = max(0.004, range_bias / 4)  # contact corrects most of the bias
    if pose == "true":
        return Accuracy(height=height)
    return Accuracy(height=height, tilt=tilt, drift=_DRIFT[pose])


def deviations(
    points: FloatArray,
    filled: NDArray[np.bool_],
    since: FloatArray,
    bin_width: float,
    accuracy: Accuracy,
    unknown: float = 0.0,
) -> FloatArray:
    """Return the standard deviation of the mean height of each bin, (N,) [m].

    It is infinite for bins without a point that was seen. ``points`` (P, 2) of the ground in
    frame L, x never decreasing, some of them ``filled`` (P,). ``since``: (N,) way that the robot
    has gone since a point of the bin was seen; ``unknown``: motion that was not measured [m].
    """
    # Which bins have seen points
    count = len(since)
    half = observation.reach(count, bin_width)
    index = np.clip(((points[:, 0] + half) / bin_width).astype(np.int64), 0, count - 1)
    in_bin = np.bincount(index, minlength=count)
    unseen = np.bincount(index[filled], minlength=count)
    result = np.full(count, np.inf)
    seen = in_bin > unseen
    if not seen.any():
        return result

    # Errors of height, of tilt, of odometry, of edges, and of what is filled
    share = unseen / np.maximum(in_bin, 1)
    steep = _steepness(points, count, bin_width)
    distance = np.abs(np.arange(count) - (count - 1) / 2) * bin_width
    drifted = accuracy.drift * np.where(seen, since, 0.0)
    along = np.sqrt(accuracy.along**2 + drifted**2 + unknown**2)
    parts = (
        accuracy.height,
        accuracy.tilt * distance,
        accuracy.climb * np.hypot(drifted, unknown),
        along * steep,
        share * (accuracy.filled * bin_width + 0.5 * steep * bin_width),
    )
    total = np.sqrt(sum(np.square(part) for part in parts))
    result[seen] = np.broadcast_to(total, count)[seen]
    return result


def _steepness(points: FloatArray, count: int, bin_width: float) -> FloatArray:
    """Return how fast the mean height of each bin changes with its place, (N,) [-].

    It is the difference of the heights at both ends of the bin divided by its width. A face at an
    end of a bin may lie in it or not, so each end is the lowest and highest ground within 2 cm.
    """
    # The ground within 2 cm of each end of a bin
    edges = (np.arange(count + 1) - count / 2) * bin_width
    low = np.searchsorted(points[:, 0], edges - 0.02)
    high = np.maximum(np.searchsorted(points[:, 0], edges + 0.02, side="right"), low + 1)
    low, high = (np.clip(ends, 0, len(points) - 1) for ends in (low, high - 1))

    # The largest rise between the ends, with faces on whichever side
    z = points[:, 1]
    ends = np.stack([z[low], z[high]])  # (2, N + 1)
    upper, lower = ends.max(axis=0), ends.min(axis=0)
    rise = np.maximum(upper[1:] - lower[:-1], upper[:-1] - lower[1:])
    return np.asarray(np.maximum(rise, 0.0) / bin_width)
