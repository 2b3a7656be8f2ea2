"""Point clouds, and slices through them along a vertical plane.

In: points in any frame with an axis that points up. Out: heights along a line, in the frame with x
and y level and z up.
"""

from collections.abc import Iterator

import numpy as np

from flipperctl.api import FloatArray

from .claims import Pose
from .cloud_faults import remark_on_rounding, without_unmeasured
from .cloud_files import CloudFile
from .layers import Choice, Ground, layer_of_points, parts_of_points
from .line import Line
from .missing import without_missing

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
    finite = file.points[np.isfinite(file.points).all(axis=1)]
    columns = [without_missing(column) for column in finite.T]
    points, unmeasured = without_unmeasured(np.column_stack([column for column, _ in columns]))
    rounded = remark_on_rounding(points, "".join(LEVEL[up]), file.single, unit, spacing)
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
    groups = np.split(points[within, 2][order], begins[1:])
    for place, group in zip(at, groups, strict=True):
        layer, above[place] = layer_of_points(group, choice)
        underside[place] = layer[0]
        heights[place] = np.quantile(layer, quantile)
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
