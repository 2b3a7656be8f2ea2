"""Cells along the robot's heading: the window is long and narrow, and turns with it in steps.

In: points and places in the map's frame M. Out: as from ``Cells``. Up to ``_MOST`` from its axis,
the window holds all ground that the bins want; for a robot that turns farther it is turned.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.cells import Cells, Grid

_MOST = 0.35
"""Angle between the heading and the window's axis from which on the window is turned [rad]."""


class TurningCells:
    """A map of cells whose rows lie across the robot's heading, or nearly so."""

    def __init__(self, grid: Grid, ahead: float, beside: float) -> None:
        """``ahead`` and ``beside``: as of ``Cells``, along the heading and beside it [m]."""
        self._sizes = grid, ahead, beside
        self._cells = Cells(*self._sizes)
        self._axis = 0.0  # of the window in frame M [rad]

    def face(self, x: float, y: float, yaw: float) -> None:
        """Turn the window, if the robot at (x, y) [m] heads elsewhere by now [rad]."""
        turn = math.remainder(yaw - self._axis, 2 * math.pi)
        if abs(turn) <= _MOST:
            return
        points, ways = self._cells.held()
        points = self._in_map(points)
        self._cells, self._axis = Cells(*self._sizes), self._axis + turn
        if len(points):
            self.add(points, x, y, ways)

    def add(self, points: FloatArray, x: float, y: float, way: float | FloatArray = 0.0) -> None:
        """See ``Cells.add``."""
        self._cells.add(self._in_window(points), *self._place(x, y), way)

    def clear_above(
        self, ceilings: Callable[[FloatArray], FloatArray], x: float, y: float, margin: float
    ) -> None:
        """See ``Cells.clear_above``."""
        here = self._place(x, y)
        self._cells.clear_above(lambda points: ceilings(self._in_map(points)), *here, margin)

    def around(
        self,
        x: float,
        y: float,
        yaw: float,
        reach: tuple[float, float],
        side: float,
        dense: bool = False,
    ) -> FloatArray:
        """See ``Cells.around``."""
        return self._cells.around(*self._place(x, y), yaw - self._axis, reach, side, dense)

    def seen_at(
        self, x: float, y: float, yaw: float, reach: tuple[float, float], side: float
    ) -> tuple[FloatArray, FloatArray]:
        """See ``Cells.seen_at``."""
        return self._cells.seen_at(*self._place(x, y), yaw - self._axis, reach, side)

    def _place(self, x: float, y: float) -> tuple[float, float]:
        if not self._axis:
            return x, y
        cos, sin = math.cos(self._axis), math.sin(self._axis)
        return cos * x + sin * y, cos * y - sin * x

    def _in_window(self, points: FloatArray) -> FloatArray:
        """Return points (P, 2) or (P, 3) in frame M, in the axes of the window."""
        return _turned(points, -self._axis)

    def _in_map(self, points: FloatArray) -> FloatArray:
        """Return points (P, 2) or (P, 3) in the axes of the window, in frame M."""
        return _turned(points, self._axis)

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later points do not change."""
        return self._cells.save(), self._axis

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        cells, self._axis = saved
        self._cells.load(cells)


def _turned(points: FloatArray, turn: float) -> FloatArray:
    """Return points turned about the vertical axis, to the left [rad]."""
    if not turn:
        return points
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, points[:, 2:]])
