"""Profiles that are stored as points in a CSV file."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

from .reading import without_missing
from .tables import read_table

_STRAIGHT = 1.05
"""Largest ratio of a profile's way in x and y to its length in x [-]."""


def read_csv(path: Path, largest_gap: float, width: float) -> tuple[FloatArray, list[str]]:
    """Return columns ``x`` and ``z`` of a CSV file with a header, (V, 2) in the file's unit.

    A line whose x or z is not known, or a value for missing heights, is a gap, which is
    interpolated linearly up to ``largest_gap`` in the file's unit. A column ``y`` may vary by the
    ``width`` [the file's unit] beside the line. Also returns remarks on missing values and on
    unknown heights at the ends.

    Raises:
        ValueError: the file is no table of x and z, x decreases, a gap is too long, there are fewer
            than two points, or the points are a cloud.
    """
    table = read_table(path, "xz", "y")
    x, heights, y = table.values.T
    if _is_cloud(x, y, width):
        raise ValueError(
            f"its column y varies from {np.nanmin(y):g} to {np.nanmax(y):g}: it is a point cloud, "
            "or a line that turns, and no profile; set terrain.start and terrain.end to slice it "
            "along a line, or remove the column y to use x and z as they are"
        )
    _check_order(x, table.lines)

    # Order and faces by the lines of the file, gaps by what is known
    heights, remark = without_missing(heights)
    _check_faces(x, heights, table.lines, len(table.names), width / 10)
    known = np.isfinite(x) & np.isfinite(heights)
    if (count := int(known.sum())) < 2:
        raise ValueError(f"at least two points are needed; it has {count}")
    _check_gaps(x, known, table.lines, largest_gap)
    remarks = [remark] if remark else []
    remarks += _remarks_on_ends(x, known, largest_gap)
    return np.column_stack([x, heights])[known], remarks


def _is_cloud(x: FloatArray, y: FloatArray, width: float) -> bool:
    """Return whether points (R,) at x and y, which may be NaN, are no line along x."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 2:
        return False
    dx, dy = np.abs(np.diff([x[known], y[known]]))
    rows = ((dx == 0) & (dy > 0)).mean() > 0.5  # as in a gridded cloud
    longer = np.hypot(dx, dy).sum() > _STRAIGHT * np.ptp(x[known])
    return bool(rows or (np.ptp(y[known]) > width and longer))


def _check_order(x: FloatArray, numbers: NDArray[np.int64]) -> None:
    """Raise if x, (R,) of lines of these numbers, decreases; it may be NaN."""
    known = np.isfinite(x)
    x, numbers = x[known], numbers[known]
    if (back := np.diff(x) < 0).any():
        at = int(np.argmax(back))
        raise ValueError(
            f"line {numbers[at + 1]}: x goes back from {x[at]:g} to {x[at + 1]:g}; it may only "
            "grow or stay"
        )


def _check_faces(
    x: FloatArray, z: FloatArray, numbers: NDArray[np.int64], columns: int, tolerance: float
) -> None:
    """Raise if ground stands at several heights at one x, (R,), that no vertical face explains.

    A face passes each height once, and the ground goes on where it ends. Points beside each other
    go up and down at one x, or back at the next x. Two points at one x are a face if x and z are
    the only ``columns``. A single place of such heights is read as it is. Heights, (R,), are the
    same within the ``tolerance``.
    """
    known = np.isfinite(x) & np.isfinite(z)
    x, z, numbers = x[known], z[known], numbers[known]
    begins = np.flatnonzero(np.append(True, np.diff(x) > 0)[: len(x)])
    if len(begins) == len(x):
        return
    ends = np.append(begins[1:], len(x)) - 1
    net, low, high = z[ends] - z[begins], *(f.reduceat(z, begins) for f in (np.minimum, np.maximum))
    turns = high - low - np.abs(net) > tolerance
    back = np.zeros(len(begins), np.bool_)
    # Rows are written from one side, or from both in turn.
    for following in (begins, np.where(ends - begins > 1, ends, begins)):
        onward = np.append(z[following[1:]], z[ends[-1]]) - z[ends]
        back |= (np.abs(net) > tolerance) & (-onward * np.sign(net) > np.abs(net) / 2)
    back &= ends - begins >= (2 if columns == 2 else 1)
    at = turns | back
    if at.sum() > 1:
        first = int(np.argmax(at))
        raise ValueError(
            f"line {numbers[begins[first]]}: at x = {x[begins[first]]:g} it has heights from "
            f"{low[first]:g} to {high[first]:g} and no vertical face: it is a point cloud, and no "
            "profile; set terrain.start and terrain.end to slice it along a line"
        )


def _check_gaps(
    x: FloatArray, known: NDArray[np.bool_], numbers: NDArray[np.int64], largest: float
) -> None:
    """Raise if known points with unknown ones between them are more than ``largest`` apart."""
    at = np.flatnonzero(known)
    gaps = np.diff(x[at])
    wide = (np.diff(at) > 1) & (gaps > largest)
    if wide.any():
        first = int(np.argmax(wide))
        raise ValueError(
            f"line {numbers[at[first] + 1]}: no height is known from x = {x[at[first]]:g} to "
            f"{x[at[first + 1]]:g}; the largest gap that is bridged is {largest:g} (largest_gap, "
            "in the file's unit)"
        )


def _remarks_on_ends(x: FloatArray, known: NDArray[np.bool_], largest: float) -> Iterator[str]:
    """Yield a remark on each end beyond the known points that is longer than a gap may be."""
    inner, outer = x[known], x[np.isfinite(x)]
    for first, last in ((outer[0], inner[0]), (inner[-1], outer[-1])):
        if last - first > largest:
            yield f"no height is known from x = {first:g} to {last:g}, which is left out"
