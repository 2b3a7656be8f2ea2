"""The ground that a LiDAR has seen, in the layout of the observation.

In: points in the map's frame M, poses. Out: ``SensedGround`` at the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import bins, observation
from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.cells import Cells, Grid
from flipperctl.core.lidar.contact import clearances
from flipperctl.core.lidar.outline import (
    Columns,
    columns,
    points_along,
    polyline,
    with_assumed,
)
from flipperctl.core.sensing import SensedGround

_SPACING = 0.02
"""Distance between the points along the ground, as dense as ``perception=planar``'s [m]."""
_GAP = 0.06
"""Seen columns farther apart than this have unseen ground between them [m]."""
_PAST = 1.5
"""Length of the map past the bins that is evaluated, so that gaps at their ends are filled [m]."""
_MARGIN = 0.4
"""Width of the map beside the strip, for headings that turn [m]."""
_GAIN = 0.3
"""Fraction of the robot's clearance above the map that is corrected at once [-]."""
_LARGEST = 0.06
"""Largest clearance that is taken for an error; larger ones are falls and jumps [m]."""


@dataclass(frozen=True)
class Stance:
    """The robot's outline on the ground."""

    circles: FloatArray
    """(C, 2) centres of circles that the tracks cover, in frame L [m]."""
    radius: float
    """Radius of the circles [m]."""


@dataclass(frozen=True)
class MapSettings:
    """Layout of the observation and quality of the map."""

    bins: int
    """Number of bins [-]."""
    bin_width: float
    """Width of a bin [m]."""
    grid: Grid = field(default_factory=Grid)
    """Sizes of the cells."""
    half_width: float = 0.36
    """Ground within this distance beside the robot's line counts [m]."""
    fewest: int = 4
    """Points without which a column is unseen [-]."""
    noise: float = 0.01
    """Standard deviation of the height of a point [m]."""


class GroundSeen:
    """A map of the ground around the robot and what is assumed about the ground at the start."""

    def __init__(self, settings: MapSettings) -> None:
        self._settings = settings
        self._reach = observation.reach(settings.bins, settings.bin_width)
        self._cells = Cells(
            settings.grid, self._reach + _PAST + _MARGIN, settings.half_width + _MARGIN
        )
        self._start: tuple[float, float] | None = None
        self._lift: float | None = None  # added to the map's heights; None before the first [m]

    def assume_level(self, x: float, z: float) -> None:
        """Take ground that was never seen for level at the height ``z``, up to ``x`` ahead [m].

        A robot knows so much when it starts: it stands on the ground below it.
        """
        self._start = x, z

    def add(self, points: FloatArray, x: float, y: float) -> None:
        """Add ``points`` (P, 3) in frame M; the robot is at (x, y) [m]."""
        self._cells.add(points, x, y)

    def sensed(self, position: FloatArray, yaw: float, stance: Stance) -> SensedGround:
        """Return the ground at the robot's ``position`` (3,) [m] and heading [rad].

        Call it once for each decision, since it corrects the map's height a bit by each stance.
        """
        s, (x, y, z) = self._settings, position.tolist()
        reach = self._reach + _PAST
        near = self._cells.around(x, y, yaw, (-reach, reach), s.half_width)
        near[:, 2] -= z
        found = columns(near, s.grid.cell, s.fewest)
        line, assumed = polyline(found, s.noise), self._assumed(x, y, z, yaw)
        if self._lift is None:
            self._lift = self._first_lift(found, assumed, stance)
        line[:, 1] += self._lift
        line, unseen = with_assumed(line, assumed, _GAP / 2)
        limits = (-self._reach, self._reach)
        points, filled = points_along(line, unseen, _SPACING, _GAP, limits)
        gaps = clearances(stance.circles, stance.radius, points)
        above = filled & (gaps < 0)  # where the robot is, there is no ground
        points[above, 1] += gaps[above]
        self._correct(np.maximum(gaps, np.where(filled, 0.0, -np.inf)), filled)
        heights = bins.mean_heights(points, s.bins, s.bin_width)
        seen = bins.occupied(points[~filled], s.bins, s.bin_width)
        return SensedGround(points, heights, filled, seen)

    def _first_lift(self, found: Columns, assumed: FloatArray, stance: Stance) -> float:
        """Return by how much the ground that is seen below the flippers differs from the start's.

        A robot starts on level ground, which its front flippers reach.
        """
        if not len(assumed):
            return 0.0
        below = (found.x > assumed[-1, 0]) & (found.x < stance.circles[:, 0].max())
        if not below.any():
            return 0.0
        lift = float(assumed[-1, 1] - np.median(found.median[below]))
        return lift if abs(lift) <= _LARGEST else 0.0

    def _correct(self, gaps: FloatArray, filled: NDArray[np.bool_]) -> None:
        """Move the map towards the tracks, if the ground that they touch was seen."""
        nearest = int(np.argmin(gaps)) if len(gaps) else 0
        if not len(gaps) or filled[nearest] or abs(gaps[nearest]) > _LARGEST:
            return
        assert self._lift is not None  # since there is ground
        self._lift += _GAIN * float(gaps[nearest])

    def _assumed(self, x: float, y: float, z: float, yaw: float) -> FloatArray:
        """Return vertices of the assumed ground in frame L, (A, 2) [m]."""
        if self._start is None:
            return np.zeros((0, 2))
        until, height = self._start
        reach = self._reach + _PAST
        along = np.arange(-reach, reach, self._settings.grid.cell)
        along = along[x + along * math.cos(yaw) < until]
        return np.column_stack([along, np.full(len(along), height - z)])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later points do not change."""
        return self._cells.save(), self._start, self._lift

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        cells, self._start, self._lift = saved
        self._cells.load(cells)
