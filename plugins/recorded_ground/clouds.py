"""Point clouds: their files, faults of their points, and slices along a vertical plane."""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.core.crosschecks import rounding

from .claims import Pose, pcd_header, ply_elements
from .layers import Choice, Ground, layer_of_points, parts_of_points
from .line import Line
from .reading import without_missing
from .tables import read_table


@dataclass(frozen=True)
class CloudFile:
    """The points of a file."""

    points: FloatArray
    """(P, 3) in the frame and unit of the file; not finite where a ray did not return."""
    pose: Pose | None = None
    """The pose that a PCD's VIEWPOINT states, unless it is the identity."""


def read_pcd(path: Path) -> CloudFile:
    """Read a PCD file (ASCII, binary or compressed).

    Raises:
        ValueError: it holds fewer or more points than its header claims, or its header is wrong.
    """
    from pypcd4.pypcd4 import PointCloud

    header = pcd_header(path)
    text = header.text.encode()
    with path.open("rb") as file:
        file.seek(header.begin)
        # Without fields of no numbers, which PCL writes and the reader refuses.
        cloud = PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(text + file.read())))
    points = np.asarray(cloud.numpy(("x", "y", "z")), dtype=np.float64)
    return CloudFile(_complete(points, header.points), header.pose)


def read_ply(path: Path) -> CloudFile:
    """Read the vertices of a PLY file (ASCII or binary).

    Raises:
        ValueError: it holds fewer or more vertices than its header claims.
    """
    from trimesh.exchange.ply import load_ply

    claimed = ply_elements(path).get("vertex", 0)
    with path.open("rb") as file:
        vertices = load_ply(file, fix_texture=False, skip_materials=True)["vertices"]
    points = np.asarray(vertices, dtype=np.float64)
    return CloudFile(_complete(points, claimed))


def _complete(points: FloatArray, claimed: int) -> FloatArray:
    if points.shape != (claimed, 3):
        raise ValueError(f"its header claims {claimed} points (x, y, z); it holds {points.shape}")
    return points


def read_text(path: Path) -> CloudFile:
    """Read the columns x, y and z of a text file; without a header, these are the first three.

    Raises:
        ValueError: it is no such table.
    """
    return CloudFile(read_table(path, "xyz", headless=True).values)


_OFTEN, _VERY_OFTEN = 4, 10
"""Smallest ratios of the number of equal points that are unmeasured, away from the origin, to that
of other places: without places around them, and with those of a line [-]."""
_NEAR, _FEW = 2, 3
"""Steps of rounding to the places around one; fewer places than of a surface [-]."""
_FILLED = 3
"""Smallest number of points for each value of a rounded coordinate [-]."""
_SHARED, _SAME_SURFACE = 0.5, 0.003
"""Smallest share of points that have another at the same place in the plane, if both coordinates
are rounded [-], and the largest difference of their heights [m]."""
_COARSER = 4
"""Smallest ratio of such rounding to the rounding that is reported far from the origin [-]."""
_FAR = 100
"""Smallest ratio of a coordinate to its extent that is far from the origin [-]."""


def without_unmeasured(points: FloatArray) -> tuple[FloatArray, str]:
    """Return the finite points (P, 3) that were measured, and a remark on the others.

    Drivers store rays without return as 0 0 0, and a registration moves these to the places of the
    sensor. Points are left out that are equal far more often than most, where no surface is around
    them, or, at 0 0 0, more often at all. One point at the origin is kept.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return points, ""
    # Equal points follow each other, so that each place has a count.
    points = points[np.lexsort(points.T)]
    begins = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))
    places = points[begins]
    counts = np.diff(np.append(np.flatnonzero(begins), len(points)))

    # Places that are hit too often, with no surface around them
    origin = (places == 0).all(axis=1)
    usual = float(np.median(counts[~origin])) if not origin.all() else 1.0
    often = counts >= _OFTEN * usual
    around = _around(places, often)
    left_out = (often & (around < _FEW)) | ((counts >= _VERY_OFTEN * usual) & (around <= 2 * _NEAR))
    left_out = np.where(origin, counts > usual, left_out)
    if not left_out.any():
        return points, ""

    # The place that is hit most often stands for all in the remark.
    most = places[np.argmax(np.where(left_out, counts, 0))]
    where = " ".join(f"{value + 0.0:g}" for value in most)
    more = f" and {int(left_out.sum()) - 1} other places" if left_out.sum() > 1 else ""
    return points[np.repeat(~left_out, counts)], (
        f"{int(counts[left_out].sum())} points lie exactly at {where}{more}, as rays without return"
        " are stored; they are left out"
    )


def _around(places: FloatArray, of: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many places, (P, 3), are few steps of rounding from each ``of`` them, (P,).

    Points that are equal since they are rounded lie on a surface, and have such neighbours.
    """
    from scipy.spatial import KDTree

    step = min(np.diff(np.unique(column)).min(initial=np.inf) for column in places.T)
    count, near = np.zeros(len(places), dtype=np.int64), (_NEAR + 0.5) * step
    if of.any() and np.isfinite(near):
        tree = KDTree(places)
        count[of] = tree.query_ball_point(places[of], near, p=np.inf, return_length=True)
        count[of] -= 1  # itself
    return count


def remark_on_rounding(points: FloatArray, level: str, unit: float, spacing: float) -> str:
    """Return a remark if coordinates are rounded to more than half the ``spacing`` [m], else "".

    ``points``, (P, 3) in a ``unit`` [m], are finite. Besides the rounding of formats, it is looked
    for along the axes ``level``, such as "xy", by points that share coordinates; a regular grid is
    not rounded.
    """
    # Formats first; a grid would look rounded, which is not meant here.
    coarse = spacing / 2 / unit * (1 + 1e-9)
    steps, filled, far = dict[str, float](), dict[str, float](), set[str]()
    columns = dict(zip("xyz", points.T, strict=True)) if len(points) else {}
    for axis, column in columns.items():
        values = np.unique(column)
        apart, largest = np.diff(values), np.abs(values).max()
        digit = rounding(values, whole=bool(level) and axis not in level)
        if digit > coarse:
            steps[axis] = digit
        elif axis in level and len(values) * _FILLED <= len(column):
            filled[axis] = float(np.median(apart)) if len(apart) else 0.0
            far |= {axis} if largest > _FAR * np.ptp(values) else set()

    # Rounding in both level axes puts points above each other on one surface.
    if len(filled) == 2:
        (height,) = {*"xyz"} - {*level}
        keys = np.column_stack([columns[axis] for axis in (height, *level)])
        apart = np.abs(np.diff(keys[np.lexsort(keys.T)], axis=0))
        shared = (apart <= (_SAME_SURFACE / unit, 0, 0)).all(axis=1)
        coarser = {axis for axis, step in filled.items() if step > _COARSER * coarse}
        far = (far or coarser) if shared.sum() >= _SHARED * len(points) else set()
    steps |= {axis: filled[axis] for axis in far if filled[axis] > coarse}
    if not steps:
        return ""
    axes = " and ".join(f"{axis} to {steps[axis] * unit:.3g} m" for axis in sorted(steps))
    return (
        f"its coordinates are rounded ({axes}), as half or single precision far from 0 or few "
        "digits do; save them in double precision or nearer to the origin"
    )


LEVEL = {
    "z": ("x", "y"),
    "y": ("z", "x"),
    "x": ("y", "z"),
    "-z": ("y", "x"),
    "-y": ("x", "z"),
    "-x": ("z", "y"),
}
"""The file's axis that points up → its axes that become x and y; both frames right-handed."""
_LEVEL = 0.1
"""Largest difference of heights at which ground goes on, as a share of the headroom [-]."""


def measured(
    file: CloudFile, unit: float, up: str, viewpoint: bool | None, spacing: float
) -> tuple[FloatArray, list[str]]:
    """Return a file's measured points with z up, (P, 3) [m], and remarks on the file.

    ``unit``: of the file [m]; ``viewpoint``: whether the pose that it states moves the points;
    ``spacing``: distance between heights along a line [m].
    """
    # Missing values, rays without return and rounding are of the file's own frame.
    finite = file.points[np.isfinite(file.points).all(axis=1)]
    columns = [without_missing(column) for column in finite.T]
    points, unmeasured = without_unmeasured(np.column_stack([column for column, _ in columns]))
    rounded = remark_on_rounding(points, "".join(LEVEL[up]), unit, spacing)
    remarks = [*(remark for _, remark in columns), unmeasured, rounded]
    if file.pose is not None:
        remarks += _remarks_on_pose(file.pose, viewpoint)
        points = _moved(points, file.pose) if viewpoint else points
    return upright(points * unit, up), [remark for remark in remarks if remark]


def _remarks_on_pose(pose: Pose, applied: bool | None) -> Iterator[str]:
    """Yield a remark on a pose that a PCD states, unless it is said whether it is ``applied``."""
    if applied is None:
        angle = np.degrees(2 * np.arccos(min(1.0, abs(pose[3]))))
        place = " ".join(f"{value:g}" for value in pose[:3])
        yield (
            f"its VIEWPOINT states a pose at {place}, turned by {angle:.3g}°, by which its points "
            "are not moved (terrain.viewpoint=true moves them, false says that they are not to be)"
        )


def _moved(points: FloatArray, pose: Pose) -> FloatArray:
    """Return points (P, 3) in the frame in which their own has the ``pose``."""
    w, *vector = pose[3:]
    turned = 2 * np.cross(vector, points)
    result: FloatArray = points + w * turned + np.cross(vector, turned) + pose[:3]
    return result


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

    Each height is the quantile of the chosen layer, over the points of the slice that are nearest
    to its place along the line. The slice reaches half the ``thickness`` [m] to either side of the
    line.

    Raises:
        ValueError: fewer than ``fewest`` points lie in the slice.
    """
    offset = points[:, :2] - np.asarray(line.start)
    along, across = offset @ line.direction, offset @ line.left
    within = (np.abs(across) <= thickness / 2) & (along >= 0) & (along <= line.length)
    if (count := int(within.sum())) < fewest:
        extent = "nothing"
        if len(points):
            (x0, y0, _), (x1, y1, _) = points.min(axis=0), points.max(axis=0)
            extent = f"x from {x0:.2f} to {x1:.2f} m and y from {y0:.2f} to {y1:.2f} m"
        raise ValueError(
            f"{fewest} points are needed within {thickness / 2:g} m of the line from {line.start} "
            f"to {line.end}, found: {count}; the cloud covers {extent}"
        )

    # The points nearest to each place, in groups
    places = line.distances
    nearest = np.searchsorted((places[:-1] + places[1:]) / 2, along[within])
    order = np.argsort(nearest, kind="stable")
    at, begins = np.unique(nearest[order], return_index=True)
    heights, above = np.full(len(places), np.nan), np.full(len(places), np.inf)
    underside = heights.copy()
    groups = np.split(points[within, 2][order], begins[1:])
    for place, group in zip(at, groups, strict=True):
        layer, above[place] = layer_of_points(group, choice)
        underside[place] = layer[0]
        heights[place] = np.quantile(layer, quantile)

    # What lies below the chosen layer may be the ground, seen through a gap
    layers, covered = heights.copy(), np.isfinite(above)
    for place, group in zip(at, groups, strict=True):
        parts = parts_of_points(group, choice)
        if parts[0][0] < underside[place] and not choice.highest:
            reach = places[place] + np.array([-1, 1]) * choice.largest_gap
            near = layers[slice(*np.searchsorted(places, reach))]
            if (np.abs(near - parts[0][-1]) <= _LEVEL * choice.headroom).any():
                # Few points are no stray ones where they continue the ground beside them.
                covered[place], underside[place] = True, parts[0][0]
                heights[place] = np.quantile(parts[0], quantile)
        above[place] = min((p[0] for p in parts if p[0] > underside[place]), default=np.inf)
    none = np.zeros(len(places), np.bool_)
    return Ground(heights, covered, none, none, none, above, underside)
