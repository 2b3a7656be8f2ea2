"""Point clouds, and slices of them along a vertical plane.

In: PCD, PLY and XYZ files in any frame with an axis that points up. Out: heights along a line, in
the frame with x and y level and z up.
"""

from pathlib import Path

import numpy as np
from flipperctl_plugins.recordings.line import Line

from flipperctl.api import FloatArray

LEVEL = {
    "z": ("x", "y"),
    "y": ("z", "x"),
    "x": ("y", "z"),
    "-z": ("y", "x"),
    "-y": ("x", "z"),
    "-x": ("z", "y"),
}
"""For the file's axis that points up, its two that become x and y; both frames right-handed."""


def read_pcd(path: Path) -> FloatArray:
    """The points of a PCD file (ASCII, binary or compressed), (P, 3) in the file's unit."""
    from pypcd4.pypcd4 import PointCloud

    cloud = PointCloud.from_path(path)
    return np.asarray(cloud.numpy(("x", "y", "z")), dtype=np.float64)


def read_ply(path: Path) -> FloatArray:
    """The vertices of a PLY file (ASCII or binary), (P, 3) in the file's unit."""
    from trimesh.exchange.ply import load_ply

    with path.open("rb") as file:
        return np.asarray(load_ply(file)["vertices"], dtype=np.float64)


def read_xyz(path: Path) -> FloatArray:
    """The first three columns of a text file, parted by blanks or commas, (P, 3)."""
    lines = (line.replace(",", " ") for line in path.read_text("utf-8").splitlines())
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2)


def upright(points: FloatArray, up: str) -> FloatArray:
    """The points in a frame with z up, (P, 3), those that are not finite left out."""
    sign = -1.0 if up.startswith("-") else 1.0
    first, second = ("xyz".index(axis) for axis in LEVEL[up])
    third = "xyz".index(up[-1])
    turned = np.column_stack([points[:, first], points[:, second], sign * points[:, third]])
    return turned[np.isfinite(turned).all(axis=1)]


def slice_along(
    points: FloatArray, line: Line, thickness: float, quantile: float, fewest: int
) -> FloatArray:
    """Heights at the line's points, (D,) [m]; NaN where the slice is empty.

    A height is the quantile of the points that are nearest to that place along the line and not
    farther than half the ``thickness`` [m] beside it.

    Raises:
        ValueError: fewer than ``fewest`` points lie in the slice.
    """
    offset = points[:, :2] - np.asarray(line.start)
    ahead, left = line.direction, np.array([-line.direction[1], line.direction[0]])
    along, beside = offset @ ahead, offset @ left
    within = (np.abs(beside) <= thickness / 2) & (along >= 0) & (along <= line.length)
    if (count := int(within.sum())) < fewest:
        extent = "nothing"
        if len(points):
            (x0, y0, _), (x1, y1, _) = points.min(axis=0), points.max(axis=0)
            extent = f"x from {x0:.2f} to {x1:.2f} m and y from {y0:.2f} to {y1:.2f} m"
        raise ValueError(
            f"only {count} points lie within {thickness / 2:g} m of the line from {line.start} to "
            f"{line.end}, {fewest} are needed; the cloud covers {extent}"
        )
    places = line.distances
    nearest = np.searchsorted((places[:-1] + places[1:]) / 2, along[within])
    order = np.argsort(nearest, kind="stable")
    at, begins = np.unique(nearest[order], return_index=True)
    heights = np.full(len(places), np.nan)
    for place, group in zip(at, np.split(points[within, 2][order], begins[1:]), strict=True):
        heights[place] = np.quantile(group, quantile)
    return heights
