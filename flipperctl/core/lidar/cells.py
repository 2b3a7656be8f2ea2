"""A rolling map: the newest points of the ground in cells around the robot.

In: points in the map's frame M and the robot's place. Out: the points near the robot, in its level
frame. The cells are a window that moves with the robot. The cell of a place is stored at its number
modulo the size of the window; a point of another place that falls there empties it. Along the
robot's heading the window is long and narrow, and turns with it in steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray
from flipperctl.core.lidar.body import turned

_BESIDE = 6
"""Cells before and behind with which a cell is compared: 15 cm, wider than most shadows [-]."""
_RANK = 4
"""The fourth fullest of these cells has the usual number of points: vertical faces, which receive
far more than level ground, fill up to three cells [-]."""
_SPARSE = 0.1  # fraction of the usual number of points below which a cell is sparse [-]
_EDGE = 1e-3  # rounded points lie so far from their lane at most, in its widths [-]


_MOST = 0.35
"""Angle between the heading and the window's axis from which on the window is turned [rad]."""


class Cells:
    """The newest points of each cell, in rows that lie across the robot's heading, or nearly so."""

    def __init__(self, cell: float, lane: float, keep: int, *, ahead: float, beside: float) -> None:
        """Cover ``ahead`` to both ends and ``beside`` to both sides of the robot [m].

        ``cell`` and ``lane``: length and width of a cell [m]; ``keep``: newest points that one
        holds.
        """
        self._cell, self._lane, self._keep = cell, lane, keep
        self._ahead, self._beside = ahead, beside
        self._shape = 2 * math.ceil(ahead / cell) + 1, 2 * math.ceil(beside / lane) + 1
        self._axis = 0.0  # of the window in frame M [rad]
        self._clear()

    def _clear(self) -> None:
        rows, lanes = self._shape
        self._points = np.full((rows * lanes, self._keep, 3), np.nan, np.float32)
        self._count = np.zeros(rows * lanes, np.int64)  # points that the cell has received
        self._place = np.full((rows * lanes, 2), np.iinfo(np.int64).min)  # whose points these are
        self._seen_at = np.zeros(rows * lanes)  # way of the robot at the newest point [m]

    def face(self, x: float, y: float, yaw: float) -> None:
        """Turn the window, if the robot at (x, y) [m] heads elsewhere by now [rad]."""
        turn = math.remainder(yaw - self._axis, 2 * math.pi)
        if abs(turn) <= _MOST:
            return
        # The points keep their places in frame M; only the cells are cut anew.
        points, ways = self._held()
        points = _rotated(points, self._axis)
        self._axis += turn
        self._clear()
        if len(points):
            self.add(points, x, y, ways)

    def add(self, points: FloatArray, x: float, y: float, way: float | FloatArray = 0.0) -> None:
        """Add ``points`` (P, 3) in frame M, oldest first; the robot is at (x, y) [m].

        Points outside the window are dropped. ``way``: what the robot had moved when it saw them,
        or each of them, (P,) [m].
        """
        # Points in the window, by the cells that they lie in
        points, (x, y) = _rotated(points, -self._axis), turned(x, y, self._axis)
        near = (np.abs(points[:, 0] - x) < self._ahead) & (np.abs(points[:, 1] - y) < self._beside)
        points = points.compress(near, axis=0)
        if not len(points):
            return
        ways = np.broadcast_to(way, near.shape)[near]

        # Sorted by cell, and by time within a cell, since the sort is stable
        place = np.floor(points[:, :2] / (self._cell, self._lane)).astype(np.int64)
        rows, lanes = self._shape
        slot = (place[:, 0] % rows) * lanes + place[:, 1] % lanes
        order = np.argsort(slot, kind="stable")
        points, place, slot = points.take(order, axis=0), place.take(order, axis=0), slot[order]
        first = np.flatnonzero(np.concatenate([[True], slot[1:] != slot[:-1]]))
        used, counts = slot[first], np.diff(np.append(first, len(slot)))

        # A cell whose place is another one by now is emptied first.
        moved = (self._place[used] != place[first]).any(axis=1)
        self._count[used[moved]] = 0
        self._points[used[moved]] = np.nan
        self._place[used] = place[first]

        # Each cell holds its newest points in a ring.
        rank = np.arange(len(slot)) - np.repeat(first, counts)
        newest = rank >= np.repeat(counts, counts) - self._keep
        at = (self._count[slot] + rank) % self._keep
        self._points[slot[newest], at[newest]] = points[newest]
        self._count[used] += counts
        self._seen_at[used] = np.maximum.reduceat(ways[order], first)

    def _held(self) -> tuple[FloatArray, FloatArray]:
        """Return the points that are held, (P, 3) [m], and ``way`` when their cells were last seen.

        They are in the axes of the window. Points of a cell follow each other, oldest first.
        """
        # Rings are unrolled, so that points come oldest first, as ``add`` takes them.
        keep = self._keep
        (slots,) = np.nonzero(self._count)
        start = np.where(self._count[slots] > keep, self._count[slots] % keep, 0)
        order = (start[:, None] + np.arange(keep)) % keep
        points = self._points[slots[:, None], order]  # (S, keep, 3)
        known = np.isfinite(points).all(axis=2)
        ways = np.broadcast_to(self._seen_at[slots][:, None], known.shape)
        return points[known].astype(np.float64), ways[known]

    def clear_above(
        self, ceilings: Callable[[FloatArray], FloatArray], x: float, y: float, margin: float
    ) -> None:
        """Forget the points that lie more than ``margin`` above their ``ceilings`` [m].

        ``ceilings`` returns heights for points (Q, 3) in frame M, (Q,) [m].
        """
        # Cells below a ray at all, by their middles
        x, y = turned(x, y, self._axis)
        slots = self._near(x, y, 0.0, (-self._ahead, self._ahead), self._beside)
        middle = (self._place[slots] + 0.5) * (self._cell, self._lane)
        above = ceilings(_rotated(middle, self._axis)) + margin
        passed = np.isfinite(above)
        slots, above = slots[passed], above[passed]

        # Of these, cells that rise above it, point by point
        heights = self._points[slots, :, 2]
        some = np.fmax.reduce(heights, axis=1) > above
        slots, heights = slots[some], heights[some]
        rows, places = np.nonzero(np.isfinite(heights))
        points = self._points[slots[rows], places].astype(np.float64)
        gone = points[:, 2] > ceilings(_rotated(points, self._axis)) + margin
        self._points[slots[rows[gone]], places[gone]] = np.nan

    def around(
        self,
        x: float,
        y: float,
        yaw: float,
        reach: tuple[float, float],
        side: float,
        dense: bool = False,
    ) -> FloatArray:
        """Return the points near the robot at (x, y) with this heading, (P, 3) [m].

        They are level, with x along the heading from the robot, y to its left and z as in frame M.
        Points from ``reach[0]`` to ``reach[1]`` along it and within ``side`` beside it are
        returned; ``dense``: without the points of cells that have few for their neighbours.
        """
        # Cells of the strip, then the points of these
        (x, y), yaw = turned(x, y, self._axis), yaw - self._axis
        slots = self._near(x, y, yaw, reach, side)
        if dense:
            slots = slots[~self._sparse(x)[slots]]
        keep = self._keep
        filled = np.arange(keep) < self._count[slots, None]
        index = (keep * slots[:, None] + np.arange(keep))[filled]
        points = self._points.reshape(-1, 3).take(index, axis=0).astype(np.float64)
        along, across = turned(points[:, 0] - x, points[:, 1] - y, yaw)
        inside = (along >= reach[0]) & (along < reach[1]) & (np.abs(across) <= side)
        return np.column_stack([along[inside], across[inside], points[inside, 2]])

    def _sparse(self, x: float) -> NDArray[np.bool_]:
        """Return which cells have received few points for their neighbours along x, (S,).

        The robot is at ``x`` [m]. Mixed returns leave such cells in the shadow of an edge.
        """
        rows, lanes = self._shape
        # The rows along the robot, in the order of their places
        wanted = math.floor(x / self._cell) - rows // 2 + np.arange(rows)
        order = wanted % rows
        current = self._place[:, 0].reshape(rows, lanes)[order] == wanted[:, None]
        count = np.where(current, self._count.reshape(rows, lanes)[order], 0)

        # The usual number of points, of the neighbours along x
        padded = np.pad(count, ((_BESIDE, _BESIDE), (0, 0)))
        around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _BESIDE + 1, axis=0)
        usual = np.partition(around, -_RANK, axis=2)[:, :, -_RANK]
        sparse = np.empty((rows, lanes), np.bool_)
        sparse[order] = count < _SPARSE * usual
        return sparse.ravel()

    def seen_at(
        self, x: float, y: float, yaw: float, reach: tuple[float, float], side: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the cells with points are along the heading, and ``way`` when last seen.

        Both are (C,) [m]; the parameters are as for ``around``.
        """
        (x, y), yaw = turned(x, y, self._axis), yaw - self._axis
        slots = self._near(x, y, yaw, reach, side)
        middle = (self._place[slots] + 0.5) * (self._cell, self._lane) - (x, y)
        along, across = turned(middle[:, 0], middle[:, 1], yaw)
        inside = np.abs(across) <= side
        return along[inside], self._seen_at[slots[inside]]

    def _near(
        self, x: float, y: float, yaw: float, reach: tuple[float, float], side: float
    ) -> NDArray[np.int64]:
        """Return the slots with points of the rows that a strip at this heading crosses."""
        rows, lanes = self._shape
        cos, sin = math.cos(yaw), math.sin(yaw)
        # Rows that the strip crosses; cells of other places are left out.
        corners = [(u * cos - v * sin) for u in reach for v in (-side, side)]
        low = math.floor((x + max(min(corners), -self._ahead)) / self._cell)
        high = math.floor((x + min(max(corners), self._ahead)) / self._cell)
        wanted = np.arange(low, high + 1)[:rows]
        slots = ((wanted % rows)[:, None] * lanes + np.arange(lanes)).ravel()
        current = (self._place[slots, 0] == np.repeat(wanted, lanes)) & (self._count[slots] > 0)

        # Lanes that it crosses, with room for rounding
        across = [(u * sin + v * cos) for u in reach for v in (-side, side)]
        lane = self._place[slots, 1]
        current &= lane >= math.floor((y + min(across)) / self._lane - _EDGE)
        current &= lane <= math.floor((y + max(across)) / self._lane + _EDGE)
        return np.asarray(slots[current])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later points do not change."""
        arrays = self._points, self._count, self._place, self._seen_at
        return tuple(array.copy() for array in arrays), self._axis

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        arrays, self._axis = saved
        self._points, self._count, self._place, self._seen_at = (a.copy() for a in arrays)


def _rotated(points: FloatArray, turn: float) -> FloatArray:
    """Return ``points`` (P, 2) or (P, 3) turned about the vertical axis, to the left [rad]."""
    if not turn:
        return points
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, points[:, 2:]])
