"""The ground that a LiDAR has seen, in the layout of the observation.

In: points in the map's frame M, poses. Out: ``SensedGround`` at the robot. A ray passes nothing
until its return, so ground on the way lies below the ray, and points of the map above it are not
ground. A robot touches the ground, so a clearance below it is an error of the map. Sideways slopes
would spread the heights of a profile, and are removed first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray, observation
from flipperctl.core.lidar.body import Mount, turned
from flipperctl.core.lidar.cells import Cells
from flipperctl.core.lidar.outline import (
    Accuracy,
    Columns,
    columns,
    deviations,
    points_along,
    polyline,
    with_assumed,
    with_drops,
)
from flipperctl.core.observation import bin_heights, occupied
from flipperctl.core.sensing import SensedGround

_SECTORS = 256  # sectors around the LiDAR in which the rays are sorted [-]
_BIN = 0.025  # length of the parts of a sector [m]


class FreeSpace:
    """The lowest ray over each place around a LiDAR."""

    def __init__(self, origin: FloatArray, points: FloatArray, reach: float, margin: float) -> None:
        """Take the rays from ``origin`` (3,) to ``points`` (P, 3) in frame M [m].

        ``reach``: horizontal distance up to which ceilings are wanted [m]. ``margin``: a ray may
        end this much before its return, because that errs [m].
        """
        self._origin = origin
        self._bins = math.ceil(reach / _BIN) + 1
        self._shift = 1 + math.ceil(margin / _BIN)
        # The lowest slope of the rays that end in each part of each sector
        away, sector = self._polar(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.where(away > 0, (points[:, 2] - origin[2]) / away, np.inf)
        part = np.minimum((away / _BIN).astype(np.int64), self._bins + self._shift)

        # A ray passes every place before its return, so that lower slopes spread inwards.
        lowest = np.full((_SECTORS, self._bins + self._shift + 1), np.inf)
        np.minimum.at(lowest, (sector, part), slope)
        self._slope = np.minimum.accumulate(lowest[:, ::-1], axis=1)[:, ::-1]

    def ceilings(self, points: FloatArray) -> FloatArray:
        """Return the height of the lowest ray over each of ``points`` (Q, 3), (Q,) [m].

        It is infinite where no ray has passed. Frame M.
        """
        away, sector = self._polar(points)
        part = np.minimum((away / _BIN).astype(np.int64), self._bins - 1) + self._shift
        return np.asarray(self._origin[2] + away * self._slope[sector, part])

    def _polar(self, points: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the horizontal distances (P,) [m] and the sectors (P,) of points (P, 3)."""
        dx, dy = points[:, 0] - self._origin[0], points[:, 1] - self._origin[1]
        turn = np.arctan2(dy, dx) * (_SECTORS / (2 * math.pi))
        return np.hypot(dx, dy), np.floor(turn).astype(np.int64) % _SECTORS


_BELOW = 0.7
"""Part of a circle's radius from its middle in which ground counts as below it, since points of a
face beside the track tell nothing about heights [-]."""


def clearances(circles: FloatArray, radius: float, points: FloatArray) -> FloatArray:
    """Return the vertical distance from the tracks down to each point, (P,) [m].

    It is infinite for points that are not below a track, and negative for points within one.
    ``circles`` (C, 2) and ``points`` (P, 2) are in frame L [m].
    """
    # Only the lower side of a circle touches, and only near its middle.
    across = points[None, :, 0] - circles[:, None, 0]  # (C, P)
    below = np.abs(across) <= _BELOW * radius
    bottom = circles[:, None, 1] - np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    gap: FloatArray = np.where(below, bottom - points[None, :, 1], np.inf)
    return np.asarray(gap.min(axis=0, initial=np.inf))


_FEWEST = 8  # points of a column, and columns, without which no slope is estimated [-]
_WIDE = 0.1  # standard deviation of the places beside the line that a column needs [m]
OFF_LINE = 0.02
"""Deviation from a line by which ground of two sides is told from ground that leans [m]."""
_LARGEST_SLOPE = 0.7  # larger slopes are of edges along the way, not of the ground [-]


def lateral_slope(points: FloatArray, cell: float, off: float = math.inf) -> float:
    """Return by how much the ground rises to the left per length [-].

    ``points`` (P, 3) are along the way, beside it and up [m]; ``cell`` is the length of a column
    [m]. It is the median of the columns' slopes, so that obstacles on one side of less than half
    the way do not count; 0 if there are too few. ``off``: standard deviation of the heights from a
    column's line up to which it counts [m]; a step from side to side is no slope.
    """
    if not len(points):
        return 0.0
    # Heights and places across, each less the mean of its column
    number = np.floor(points[:, 0] / cell).astype(np.int64)
    number -= number.min()
    count = np.maximum(np.bincount(number), 1)
    across, height = (
        points[:, axis] - (np.bincount(number, points[:, axis]) / count)[number] for axis in (1, 2)
    )

    # A line through each column that is wide enough; the median leaves out obstacles.
    squares = np.bincount(number, across**2)
    usable = (count >= _FEWEST) & (squares >= _WIDE**2 * count)
    if math.isfinite(off):
        risen = np.bincount(number, across * height) / np.maximum(squares, 1e-12)
        left = np.bincount(number, height**2) - risen**2 * squares
        usable &= left <= off**2 * count
    if usable.sum() < _FEWEST:
        return 0.0
    slope = float(np.median(np.bincount(number, across * height)[usable] / squares[usable]))
    return slope if abs(slope) <= _LARGEST_SLOPE else 0.0


def straightened(points: FloatArray, slope: float) -> FloatArray:
    """Return ``points`` (P, 3) without a sideways slope; heights on the line stay [m]."""
    result = points.copy()
    result[:, 2] -= slope * points[:, 1]
    return result


def side_of(points: FloatArray, sign: float, slope: float) -> FloatArray:
    """Return those of ``points`` (P, 3) that are below the tracks of one side, (S, 3) [m].

    ``sign``: 1 for the left, -1 for the right. Their sideways slope is removed about the middle of
    that side, so that ground that leans differs from side to side.
    """
    side = points[(sign * points[:, 1] > 0) & (np.abs(points[:, 1]) <= observation.HALF_WIDTH)]
    middle = sign * observation.HALF_WIDTH / 2
    return straightened(side - (0.0, middle, 0.0), slope)


_SPACING = 0.02
"""Distance between the points along the ground, as dense as ``perception=planar``'s [m]."""
_GAP = 0.06  # seen columns farther apart than this have unseen ground between them [m]
_PAST = 1.5
"""Length of the map past the bins that is evaluated, so that gaps at their ends are filled [m]."""
_MARGIN = 0.4  # width of the map beside the strip, for headings that turn [m]
_GAIN = 0.3  # fraction of the robot's clearance above the map that is corrected at once [-]
_LARGEST = 0.06
"""Largest correction of the map's height, and of a scan's height against the map [m]."""
_LEVEL = 0.1, 0.03
"""Ground is level if it rises by at most the second length within the first to both sides [m]."""
_NEAREST, _FARTHEST = 0.2, 1.6
"""Range ahead of the robot in which a scan is compared with the map [m]."""
_REGISTERED = 20  # points of a column of the map with which a scan is compared [-]
_FEWEST_COLUMNS = 8  # columns that scan and map must have in common to be compared [-]
_BEFORE = 3.0  # a ray counts up to this before its return, in standard deviations of a point [-]
_ABOVE = 0.03  # height above a ray from which points of the map are not ground [m]


MEANING = (
    "map of the ground in which the policy was trained: lengths cell along and lane across the "
    "way, half_width to each side and noise of a point's height in m, keep points a cell, fewest "
    "points of a column that is seen; deskew: points are corrected for the motion within a scan"
)
"""The settings in words, for the metadata of exported policies."""


@dataclass(frozen=True)
class MapQuality:
    """How the points of scans make up the ground."""

    cell: float = 0.025
    """Length of the map's cells along the way [m]."""
    lane: float = 0.09
    """Width of the map's cells [m]."""
    keep: int = 32
    """Newest points that a cell holds [-]."""
    half_width: float = 0.36
    """Ground within this distance beside the robot's line counts [m]."""
    fewest: int = 4
    """Points without which a column of cells is unseen [-]."""
    noise: float = 0.01
    """Standard deviation of the height of a point [m]."""
    deskew: bool = True
    """Whether points are corrected for the robot's motion within a scan."""


@dataclass(frozen=True, kw_only=True)
class Lidar:
    """What a robot's controller has to know of its LiDAR, and of what that is mounted on."""

    quality: MapQuality
    mount: Mount
    chassis_width: float
    """Width of the chassis between the flippers [m]."""
    overall_width: float
    """Width over the outer sides of the flippers [m]."""
    range_bias: float
    """Largest error of all distances [m]."""
    tilt_error: float
    """Standard deviation of roll and pitch [rad]."""


@dataclass(frozen=True)
class MapSettings:
    """Layout of the observation, and quality of the map."""

    bins: int
    """Number of bins [-]."""
    bin_width: float
    """Width of a bin [m]."""
    highest: bool = True
    """Whether the highest points of the bins are wanted, too."""
    quality: MapQuality = MapQuality()
    """How the points of scans make up the ground."""
    accuracy: Accuracy = field(default_factory=Accuracy)
    """What makes heights err."""
    sides: bool = False
    """Whether the heights of both sides are wanted, too."""


class GroundSeen:
    """A map of the ground around the robot and what is assumed about the ground at the start."""

    def __init__(self, settings: MapSettings) -> None:
        self._settings, self._quality = settings, (q := settings.quality)
        self._reach = observation.reach(settings.bins, settings.bin_width)
        ahead, beside = self._reach + _PAST + _MARGIN, q.half_width + _MARGIN
        self._cells = Cells(q.cell, q.lane, q.keep, ahead=ahead, beside=beside)
        self._start: tuple[float, float, float, float] | None = None
        self._lift: float | None = None  # added to the map's heights; None before the first [m]
        self._at: tuple[float, float] | None = None  # the robot's latest place [m]
        self._way = 0.0  # that the robot has moved [m]

    def assume_level(self, until: float, yaw: float, z: float, slope: float = 0.0) -> None:
        """Take ground that was never seen for a plane, up to ``until`` in the direction ``yaw``.

        ``z``: height at ``until`` [m]; ``slope``: by which the plane rises there [-]. A robot knows
        so much when it starts. Once it has turned back, it may be on another storey.
        """
        self._start = until, yaw, z, slope
        if slope:
            self._lift = 0.0

    def add(self, points: FloatArray, x: float, y: float, yaw: float) -> None:
        """Add ``points`` (P, 3) in frame M; the robot is at (x, y) [m] and heads there [rad]."""
        self._move_to(x, y)
        self._cells.face(x, y, yaw)
        self._cells.add(points, x, y, self._way)

    def clear(self, origin: FloatArray, points: FloatArray, x: float, y: float) -> None:
        """Forget ground that the rays from ``origin`` (3,) to ``points`` (P, 3) have passed.

        Frame M [m]; the robot is at (x, y) [m].
        """
        reach = self._reach + _PAST + _MARGIN
        margin = _BEFORE * self._quality.noise
        self._cells.clear_above(FreeSpace(origin, points, reach, margin).ceilings, x, y, _ABOVE)

    def _move_to(self, x: float, y: float) -> None:
        if self._at is not None:
            self._way += math.hypot(x - self._at[0], y - self._at[1])
        self._at = x, y

    def height_error(self, points: FloatArray, x: float, y: float, yaw: float) -> float:
        """Return by how much ``points`` (P, 3) in frame M lie above the map on the whole [m].

        Level parts of the map ahead of the robot at (x, y) [m] count; 0 if there are too few.
        """
        # The scan in the strip ahead, where both have seen the same ground
        q, reach = self._quality, (_NEAREST, _FARTHEST)
        along, across = turned(points[:, 0] - x, points[:, 1] - y, yaw)
        strip = (np.abs(across) <= q.half_width) & (along >= reach[0]) & (along < reach[1])
        (near,) = np.nonzero(strip)
        scanned = np.column_stack([along[near], across[near], points[near, 2]])
        counts = np.bincount(np.floor(scanned[:, 0] / q.cell).astype(np.int64))
        if np.count_nonzero(counts >= q.fewest) < _FEWEST_COLUMNS:  # as of a sector to the side
            return 0.0

        # Columns that are level in the map, since an edge that is shifted along would count as
        # height
        around = self._cells.around(x, y, yaw, reach, q.half_width)
        slope = lateral_slope(around, q.cell)
        known = columns(straightened(around, slope), q.cell, _REGISTERED)
        level = known.high - known.low < 3 * q.noise + q.cell
        new = columns(straightened(scanned, slope), q.cell, q.fewest)
        _, i, j = np.intersect1d(
            np.round(known.x[level] / q.cell, 1),
            np.round(new.x / q.cell, 1),
            return_indices=True,
        )
        if len(i) < _FEWEST_COLUMNS:
            return 0.0
        error = float(np.median(new.median[j] - known.median[level][i]))
        return error if abs(error) <= _LARGEST else 0.0

    def sensed(
        self,
        position: FloatArray,
        yaw: float,
        circles: FloatArray,
        radius: float,
        unknown: float = 0.0,
        roll: float = 0.0,
    ) -> SensedGround:
        """Return the ground at the robot's ``position`` (3,) [m] and heading [rad].

        ``circles`` (C, 2) of this ``radius``, in frame L, are what the tracks cover; ``unknown``:
        how far the robot may have moved since its position was estimated [m]; ``roll``: of the
        robot [rad].
        Call it once for each decision, since it corrects the map's height a bit by each stance.
        """
        # The map around the robot, without a sideways slope, in frame L
        s, q, (x, y, z) = self._settings, self._quality, position.tolist()
        self._move_to(x, y)
        self._cells.face(x, y, yaw)
        reach = self._reach + _PAST
        near = self._cells.around(x, y, yaw, (-reach, reach), q.half_width, dense=True)
        near[:, 2] -= z
        # Without sides the map stays as policies without them were trained and calibrated on it.
        slope = lateral_slope(near, q.cell, OFF_LINE if s.sides else math.inf)
        ground_columns = columns(straightened(near, slope), q.cell, q.fewest)

        # The line of the ground: seen, assumed at the start, with drops behind edges
        assumed = self._assumed(x, y, z, yaw)
        if self._lift is None:
            self._lift = self._first_lift(ground_columns, assumed, circles)
        # The sides by the map's height of now, which this stance corrects for the next decision
        lift = self._lift
        points, filled, gaps = self._outlined(ground_columns, assumed, circles, radius, lift)
        self._correct(points, gaps, filled)

        # What the observation has: heights, which bins were seen, and how far each may err
        heights = bin_heights(points, s.bins, s.bin_width, highest=s.highest)
        for sign in observation.SIDES.values() if s.sides else ():
            side = columns(side_of(near, sign, slope), q.cell, (q.fewest + 1) // 2)
            risen = 0.0, sign * observation.HALF_WIDTH / 2 * math.sin(roll)
            below, *_ = self._outlined(side, assumed, circles + risen, radius, lift)
            more = bin_heights(below, s.bins, s.bin_width, highest=s.highest)
            heights = np.concatenate([heights, more])
        seen = occupied(points[~filled], s.bins, s.bin_width)
        since = self._since(x, y, yaw)
        deviation = deviations(points, filled, since, s.bin_width, s.accuracy, unknown)
        deviation = np.where(seen, deviation, np.inf)
        return SensedGround(points, heights, filled, seen, deviation=deviation)

    def _outlined(
        self,
        ground_columns: Columns,
        assumed: FloatArray,
        circles: FloatArray,
        radius: float,
        lift: float,
    ) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
        """Return points along the ground, (P, 2) [m], which are filled, and the tracks' gaps [m].

        ``lift`` is added to the heights of ``ground_columns`` [m].
        """
        line = polyline(ground_columns, self._quality.noise)
        line[:, 1] += lift
        line, unseen = with_assumed(line, assumed, _GAP / 2)
        line, unseen = with_drops(line, unseen, _GAP, self._quality.cell / 2)
        limits = (-self._reach, self._reach)
        points, filled = points_along(line, unseen, _SPACING, _GAP, limits)

        # No ground is where the robot is: filled ground is lowered below its tracks.
        gaps = clearances(circles, radius, points)
        above = filled & (gaps < 0)
        points[above, 1] += gaps[above]
        return points, filled, np.where(above, 0.0, gaps)

    def points_around(self, position: FloatArray, yaw: float) -> FloatArray:
        """Return the points of the map that ``sensed`` uses, (P, 3) in frame L [m]."""
        x, y, z = position.tolist()
        near = self._cells.around(x, y, yaw, (-self._reach, self._reach), self._quality.half_width)
        near[:, 2] += (self._lift or 0.0) - z
        return near

    def _since(self, x: float, y: float, yaw: float) -> FloatArray:
        """Return the way that the robot has gone since it saw each bin, (N,) [m]."""
        s, half = self._settings, self._reach
        along, way = self._cells.seen_at(x, y, yaw, (-half, half), self._quality.half_width)
        index = np.floor((along + half) / s.bin_width).astype(np.int64)
        inside = (index >= 0) & (index < s.bins)
        latest = np.zeros(s.bins)
        np.maximum.at(latest, index[inside], way[inside])
        return self._way - latest

    def _first_lift(
        self, ground_columns: Columns, assumed: FloatArray, circles: FloatArray
    ) -> float:
        """Return by how much the ground that is seen below the flippers differs from the start's.

        A robot starts on level ground, which its front flippers reach.
        """
        if not len(assumed):
            return 0.0
        below = (ground_columns.x > assumed[-1, 0]) & (ground_columns.x < circles[:, 0].max())
        if not below.any():
            return 0.0
        lift = float(assumed[-1, 1] - np.median(ground_columns.median[below]))
        return lift if abs(lift) <= _LARGEST else 0.0

    def _correct(self, points: FloatArray, gaps: FloatArray, filled: NDArray[np.bool_]) -> None:
        """Move the map towards the tracks, if they touch level ground that was seen.

        A contact at an edge tells nothing, since odometry shifts edges along x.
        """
        if not len(gaps):
            return
        # The nearest point below a track is touched, which counts if it is on level ground.
        contact = int(np.argmin(gaps))
        near = np.abs(points[:, 0] - points[contact, 0]) <= _LEVEL[0]
        if filled[near].any() or np.ptp(points[near, 1]) > _LEVEL[1] or np.isinf(gaps[contact]):
            return
        assert self._lift is not None  # since there is ground
        lift = self._lift + _GAIN * float(gaps[contact])
        self._lift = min(_LARGEST, max(-_LARGEST, lift))

    def _assumed(self, x: float, y: float, z: float, yaw: float) -> FloatArray:
        """Return vertices of the assumed ground in frame L, (A, 2) [m]."""
        if self._start is None:
            return np.zeros((0, 2))
        # The plane of the start, up to its end, as long as the robot has not turned back
        until, ahead, height, slope = self._start
        facing = math.cos(yaw - ahead)
        if facing <= 0:
            return np.zeros((0, 2))
        place = x * math.cos(ahead) + y * math.sin(ahead)
        reach = self._reach + _PAST
        along = np.arange(-reach, reach, self._quality.cell)
        along = along[place + along * facing < until]
        rise = slope * (place + along * facing - until)
        return np.column_stack([along, height - z + rise])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later points do not change."""
        return self._cells.save(), self._start, self._lift, self._at, self._way

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        cells, self._start, self._lift, self._at, self._way = saved
        self._cells.load(cells)
