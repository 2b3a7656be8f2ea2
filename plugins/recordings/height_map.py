"""Height maps: a grid of heights and where its cells lie.

In: NPY files, whose frame must be stated, and GeoTIFF files, which state it. Out: heights along a
line. The frame: x and y level, z up [m].
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from flipperctl_plugins.recordings.line import Line

from flipperctl.api import FloatArray


@dataclass(frozen=True)
class HeightMap:
    """A grid of heights."""

    heights: FloatArray
    """(R, C) [m], NaN where unknown"""
    to_cell: FloatArray
    """(2, 3): (row, column) = to_cell · (x, y, 1); a cell's centre has whole numbers"""

    def along(self, line: Line) -> FloatArray:
        """Heights at the line's points, between cells bilinear, (D,) [m]; NaN where unknown.

        Raises:
            ValueError: an end of the line lies outside of the map.
        """
        cells = line.points @ self.to_cell[:, :2].T + self.to_cell[:, 2]  # (D, 2)
        last = np.array(self.heights.shape) - 1
        for end, cell in ((line.start, cells[0]), (line.end, cells[-1])):
            if (cell < -1e-6).any() or (cell > last + 1e-6).any():
                raise ValueError(f"{end} lies outside of the map, which covers {self._extent()}")
        cells = np.clip(cells, 0, last)
        low = np.minimum(cells.astype(int), np.maximum(last - 1, 0))
        share = cells - low
        total = np.zeros(len(cells))
        for row in (0, 1):
            for column in (0, 1):
                weight = np.abs(1 - row - share[:, 0]) * np.abs(1 - column - share[:, 1])
                at = np.minimum(low + np.array([row, column]), last)
                # A cell that has no part in a height may be unknown.
                total += np.where(weight > 1e-9, weight * self.heights[at[:, 0], at[:, 1]], 0.0)
        return total

    def _extent(self) -> str:
        last = np.array(self.heights.shape) - 1
        corners = np.array([[0, 0], [0, last[1]], [last[0], 0], last])
        places = np.linalg.solve(self.to_cell[:, :2], (corners - self.to_cell[:, 2]).T)  # (2, 4)
        (x0, y0), (x1, y1) = places.min(axis=1), places.max(axis=1)
        return f"x from {x0:.2f} to {x1:.2f} m and y from {y0:.2f} to {y1:.2f} m"


def read_npy(path: Path, resolution: float | None, unit: float, rows: int) -> HeightMap:
    """A map whose cell [0, 0] lies at (0, 0); columns run along x, rows along y.

    ``resolution`` is the size of a cell and ``unit`` that of the heights [m]; with ``rows`` of -1
    they run against y, as in pictures.

    Raises:
        ValueError: it is no grid of numbers, or the resolution is not stated.
    """
    heights = np.load(path, allow_pickle=False)
    if heights.ndim != 2 or heights.dtype.kind not in "iuf" or min(heights.shape) < 2:
        raise ValueError(
            f"a grid of numbers (rows, columns) is needed; it is {heights.dtype} {heights.shape}"
        )
    return HeightMap(np.asarray(heights, dtype=np.float64) * unit, _stated(resolution, rows))


def read_geotiff(path: Path, resolution: float | None, unit: float, rows: int) -> HeightMap:
    """The first band; the frame is the file's own, or stated as for NPY if it has none.

    Raises:
        ValueError: its coordinates are degrees, or the frame is stated twice or not at all.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, driver="GTiff") as file:
            heights = file.read(1, masked=True).astype(np.float64).filled(np.nan) * unit
            transform, crs = file.transform, file.crs
    if transform.is_identity:
        return HeightMap(heights, _stated(resolution, rows))
    if resolution is not None:
        raise ValueError("the file says where its cells lie; a resolution must not be stated too")
    if crs is not None and crs.is_geographic:
        raise ValueError("its coordinates are degrees; project it to metres, as gdalwarp does")
    metres = crs.linear_units_factor[1] if crs is not None else 1.0
    inverse = ~transform  # (x, y) → (column, row) of a cell's corner
    column = [inverse.a / metres, inverse.b / metres, inverse.c - 0.5]
    row = [inverse.d / metres, inverse.e / metres, inverse.f - 0.5]
    return HeightMap(heights, np.array([row, column]))


def _stated(resolution: float | None, rows: int) -> FloatArray:
    if resolution is None:
        raise ValueError("it does not say how large its cells are; state the resolution")
    return np.array([[0.0, rows / resolution, 0.0], [1.0 / resolution, 0.0, 0.0]])
