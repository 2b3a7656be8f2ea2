"""Point clouds, and slices through them along a vertical plane.

In: PCD, PLY and XYZ files in any frame with an axis that points up. Out: heights along a line, in
the frame with x and y level and z up.
"""

import re
from pathlib import Path

import numpy as np

from flipperctl.api import FloatArray

from .claims import pcd_points, ply_vertices
from .layers import Choice, Ground, layer_of_points
from .line import Line
from .text import read_lines

_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)
LEVEL = {
    "z": ("x", "y"),
    "y": ("z", "x"),
    "x": ("y", "z"),
    "-z": ("y", "x"),
    "-y": ("x", "z"),
    "-x": ("z", "y"),
}
"""The file's axis that points up → its axes that become x and y; both frames right-handed."""


def read_pcd(path: Path) -> FloatArray:
    """Return the points of a PCD file (ASCII, binary or compressed), (P, 3) in the file's unit.

    Raises:
        ValueError: it holds fewer or more points than its header claims.
    """
    from pypcd4.pypcd4 import PointCloud

    claimed = pcd_points(path)
    cloud = PointCloud.from_path(path)
    return _complete(np.asarray(cloud.numpy(("x", "y", "z")), dtype=np.float64), claimed)


def read_ply(path: Path) -> FloatArray:
    """Return the vertices of a PLY file (ASCII or binary), (P, 3) in the file's unit.

    Raises:
        ValueError: it holds fewer or more vertices than its header claims.
    """
    from trimesh.exchange.ply import load_ply

    claimed = ply_vertices(path)
    with path.open("rb") as file:
        found = load_ply(file, fix_texture=False, skip_materials=True)
    return _complete(np.asarray(found["vertices"], dtype=np.float64), claimed)


def _complete(points: FloatArray, claimed: int) -> FloatArray:
    if points.shape != (claimed, 3):
        raise ValueError(f"its header claims {claimed} points (x, y, z); it holds {points.shape}")
    return points


def read_xyz(path: Path) -> FloatArray:
    """Return the first three columns of a text file, (P, 3) in the file's unit.

    Columns are separated by blanks or commas, or by semicolons or blanks where the decimal sign is
    a comma.

    Raises:
        ValueError: the file is not text, or a line does not begin with three numbers.
    """
    lines = (_with_decimal_points(line) for line in read_lines(path) if not line.startswith("//"))
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2)


def _with_decimal_points(line: str) -> str:
    """Return the line with blanks between its columns and with decimal points."""
    columns = line.replace(";", " ").split()
    if ";" in line or (len(columns) > 2 and all(map(_DECIMAL_COMMA.fullmatch, columns[:3]))):
        return " ".join(columns).replace(",", ".")
    return line.replace(",", " ")


def upright(points: FloatArray, up: str) -> FloatArray:
    """Return the finite points in a frame with z up, (P', 3) in the unit of ``points``."""
    sign = -1.0 if up.startswith("-") else 1.0
    first, second = ("xyz".index(axis) for axis in LEVEL[up])
    third = "xyz".index(up[-1])
    turned = np.column_stack([points[:, first], points[:, second], sign * points[:, third]])
    return turned[np.isfinite(turned).all(axis=1)]


def slice_along(
    points: FloatArray, line: Line, thickness: float, quantile: float, fewest: int, choice: Choice
) -> Ground:
    """Return the ground at the line's points; its heights are NaN where the slice is empty.

    Each height is the quantile of the chosen layer of those points of the slice that are nearest to
    its place along the line. The slice reaches half the ``thickness`` [m] to either side of the
    line.

    Raises:
        ValueError: fewer than ``fewest`` points lie in the slice.
    """
    offset = points[:, :2] - np.asarray(line.start)
    along, beside = offset @ line.direction, offset @ line.left
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
    heights, above = np.full(len(places), np.nan), np.full(len(places), np.inf)
    underside = heights.copy()
    for place, group in zip(at, np.split(points[within, 2][order], begins[1:]), strict=True):
        layer, above[place] = layer_of_points(group, choice)
        underside[place] = layer[0]
        heights[place] = np.quantile(layer, quantile)
    none = np.zeros(len(places), np.bool_)
    ground = Ground(heights, np.isfinite(above), none, none, none, above, underside)
    return ground.without_ceilings_over_holes(places, choice)
