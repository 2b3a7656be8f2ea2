"""Height maps: a grid of heights and the positions of its cells.

In: NPY files, whose frame must be stated; ``geotiff`` reads files that contain theirs. Out: heights
along a line, in a frame with x and y level and z up [m].
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

from .line import Line
from .reading import known_heights

Part = tuple[slice, slice]
"""Ranges of rows and of columns of a grid."""
MAX_CELLS = 25_000_000
"""Largest number of cells around a line that are read at once, which take 200 MB."""


@dataclass(frozen=True)
class HeightMap:
    """A grid of heights, from which only the cells around a line are read."""

    shape: tuple[int, int]
    """Numbers of rows and of columns [-]."""
    to_cell: FloatArray
    """Affine map (2, 3): (row, column) = to_cell · (x, y, 1); integers are cell centres."""
    heights: Callable[[Part], tuple[FloatArray, str]]
    """Returns the heights of a part of the grid [m], NaN where unknown, and a remark on those."""
    remarks: tuple[str, ...] = ()
    """Remarks on what the file states."""
    stretch: Callable[[FloatArray], FloatArray] = lambda place: np.eye(2)
    """Returns metres of ground per metre of the frame at (x, y) [m], as ``Line.stretch``."""

    @property
    def extent(self) -> FloatArray:
        """Extent in x and y, (2,) [m]."""
        extent: FloatArray = np.ptp(self._corners(), axis=1)
        return extent

    def on_ground(self, line: Line) -> Line:
        """Return the line with the lengths of the ground at its middle, if that is on the map."""
        middle = np.add(line.start, line.end) / 2
        if not self._are_inside(self._cells(middle)):
            return line
        return replace(line, stretch=self.stretch(middle))

    def along(self, line: Line) -> tuple[FloatArray, str]:
        """Return the heights at the line's points, (D,) [m]; NaN where unknown.

        Heights between cell centres are interpolated bilinearly. Also returns a remark on missing
        values, empty without any.

        Raises:
            ValueError: an end of the line lies outside the map, or too many cells surround it.
        """
        cells = self._cells(line.points)
        for end, cell in ((line.start, cells[0]), (line.end, cells[-1])):
            if not self._are_inside(cell):
                raise ValueError(f"{end} lies outside the map, which covers {self._extent()}")
        return self._at(cells, line)

    def beside(self, line: Line, along: FloatArray, left: FloatArray) -> FloatArray:
        """Return the heights on a grid, (A, L) [m]; NaN where unknown or outside the map.

        ``along``, (A,), are distances from the line's start in its direction and ``left``, (L,),
        distances to its left [m].

        Raises:
            ValueError: too many cells surround the grid.
        """
        ahead = np.asarray(line.start) + along[:, None, None] * line.direction  # (A, 1, 2)
        places = (ahead + left[:, None] * line.left).reshape(-1, 2)
        # Each place as a cell; outside the map nothing is known.
        cells = self._cells(places)
        inside = self._are_inside(cells)
        heights = np.full(len(cells), np.nan)
        if inside.any():
            heights[inside], _ = self._at(cells[inside], line)
        return heights.reshape(len(along), len(left))

    def _cells(self, places: FloatArray) -> FloatArray:
        """Return the fractional row and column of places (…, 2) in (x, y) [m]."""
        cells: FloatArray = places @ self.to_cell[:, :2].T + self.to_cell[:, 2]
        return cells

    def _are_inside(self, cells: FloatArray) -> NDArray[np.bool_]:
        last = np.array(self.shape) - 1
        return np.asarray(((cells >= -1e-6) & (cells <= last + 1e-6)).all(axis=-1))

    def _at(self, cells: FloatArray, line: Line) -> tuple[FloatArray, str]:
        """Return the heights at cells (P, 2), fractional row and column; errors name the line."""
        last = np.array(self.shape) - 1
        cells = np.clip(cells, 0, last)
        # The cell below each place, and how far it is to the next one
        low = np.minimum(cells.astype(int), np.maximum(last - 1, 0))
        fraction = cells - low  # (D, 2) position between two cell centres [-]
        first, end_cell = low.min(axis=0), np.minimum(low.max(axis=0) + 1, last)
        if (count := int(np.prod(end_cell - first + 1))) > MAX_CELLS:
            raise ValueError(
                f"{count} cells lie around the line from {line.start} to {line.end}; "
                f"{MAX_CELLS} are allowed: a line along rows or columns needs fewer"
            )

        # The four cells around, by their weights
        part = slice(first[0], end_cell[0] + 1), slice(first[1], end_cell[1] + 1)
        heights, remark = self.heights(part)
        total = np.zeros(len(cells))
        for row in (0, 1):
            for column in (0, 1):
                weight = np.abs(1 - row - fraction[:, 0]) * np.abs(1 - column - fraction[:, 1])
                at = np.minimum(low + np.array([row, column]), last) - first
                # A cell of zero weight may be unknown (NaN).
                total += np.where(weight > 1e-9, weight * heights[at[:, 0], at[:, 1]], 0.0)
        return total, remark

    def _corners(self) -> FloatArray:
        """Return the places of the outermost cells, (2, 4) of x and y [m]."""
        last = np.array(self.shape) - 1
        corners = np.array([[0, 0], [0, last[1]], [last[0], 0], last])
        places = np.linalg.solve(self.to_cell[:, :2], (corners - self.to_cell[:, 2]).T)
        return np.asarray(places, dtype=np.float64)

    def _extent(self) -> str:
        corners = self._corners()
        (x0, y0), (x1, y1) = corners.min(axis=1), corners.max(axis=1)
        return f"x from {x0:.2f} to {x1:.2f} m and y from {y0:.2f} to {y1:.2f} m"


def read_npy(
    path: Path, resolution: float | None, unit: float | None, rows: int, no_data: float | None
) -> HeightMap:
    """Return a map whose cell [0, 0] lies at (0, 0), with columns along x and rows along y.

    ``resolution`` is the size of a cell [m] and ``unit`` the unit of the heights [m], metres if it
    is None. With ``rows`` of -1 the rows run against y, as in images. ``no_data`` marks unknown
    heights, in the file's unit.

    Raises:
        ValueError: the file is not a grid of numbers, or the resolution is not stated.
    """
    # The file is memory-mapped: a header that claims more than it holds allocates no memory.
    grid = np.lib.format.open_memmap(path, mode="r")
    if grid.ndim != 2 or grid.dtype.kind not in "iuf" or min(grid.shape) < 2:
        raise ValueError(
            f"a grid of numbers (rows, columns) is needed; it is {grid.dtype} {grid.shape}"
        )
    shape = (int(grid.shape[0]), int(grid.shape[1]))

    def heights(part: Part) -> tuple[FloatArray, str]:
        values, metres = np.asarray(grid[part], dtype=np.float64), unit or 1.0
        known, remark = known_heights(values, no_data, metres)
        return known * metres, remark

    return HeightMap(shape, cells_from_resolution(resolution, rows), heights)


def cells_from_resolution(resolution: float | None, rows: int) -> FloatArray:
    """Return ``HeightMap.to_cell`` of a map whose cell [0, 0] lies at (0, 0).

    Raises:
        ValueError: the ``resolution`` [m] is not stated.
    """
    if resolution is None:
        raise ValueError("it does not state the size of its cells [m]; set terrain.resolution")
    return np.array([[0.0, rows / resolution, 0.0], [1.0 / resolution, 0.0, 0.0]])
