"""Profiles that are stored as points in a CSV file."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

from .reading import read_lines, without_missing

_DELIMITERS = ";\t,"
"""Delimiters by precedence; a comma may be the decimal sign if another separates the columns."""
_COMMENTS = ("#", "//")
"""Beginnings of lines that are comments."""
_STRAIGHT = 1.05
"""Largest ratio of a profile's way in x and y to its length in x [-]."""
_LARGE = 1 << 20
"""Smallest size of a file that numpy's compiled reader tries first [bytes]."""


def read_csv(path: Path, largest_gap: float, width: float) -> tuple[FloatArray, list[str]]:
    """Return columns ``x`` and ``z`` of a CSV file with a header, (V, 2) in the file's unit.

    Columns are separated by commas, or by semicolons or tabs with decimal points or commas, as
    spreadsheets write them. Lines that begin with # or // are comments. A line whose x or z is NaN
    or a value for missing heights is a gap, which is interpolated linearly up to ``largest_gap``
    in the file's unit. A column ``y`` may vary by the ``width`` [the file's unit] beside the line.
    Also returns remarks on missing values and on unknown heights at the ends.

    Raises:
        ValueError: a column is missing, a value is not a number, x decreases, a gap is too long,
            there are fewer than two points, or the points are a cloud.
    """
    table, numbers, columns = (path.stat().st_size >= _LARGE and _compiled(path)) or _rows(path)
    points, y = table[:, :2], table[:, 2]
    if _is_cloud(points[:, 0], y, width):
        raise ValueError(
            f"its column y varies from {np.nanmin(y):g} to {np.nanmax(y):g}: it is a point cloud, "
            "or a line that turns, and no profile; set terrain.start and terrain.end to slice it "
            "along a line, or remove the column y to use x and z as they are"
        )
    _check_order(points[:, 0], numbers)
    heights, remark = without_missing(points[:, 1])
    _check_faces(points[:, 0], heights, numbers, columns, width / 10)
    known = np.isfinite(points[:, 0]) & np.isfinite(heights)
    if (count := int(known.sum())) < 2:
        raise ValueError(f"at least two points are needed; it has {count}")
    _check_gaps(points[:, 0], known, numbers, largest_gap)
    remarks = [remark] if remark else []
    return points[known], [*remarks, *_remarks_on_ends(points[:, 0], known, largest_gap)]


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


def _rows(path: Path) -> tuple[FloatArray, NDArray[np.int64], int]:
    """Return x, z and y of each line, (R, 3), which may be NaN, and the lines' numbers, (R,).

    The last is the number of columns.
    """
    lines = read_lines(path)
    texts = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith(_COMMENTS)
    ]
    if texts and texts[0][1].lower().startswith("sep="):  # some spreadsheets write this line first
        texts = texts[1:]
    header = texts[0][1] if texts else ""
    delimiter = next((sign for sign in _DELIMITERS if sign in header), ",")
    try:
        parsed = csv.reader(
            (line for _, line in texts), delimiter=delimiter, skipinitialspace=True, strict=False
        )
        rows = list(parsed)
    except csv.Error as error:
        raise ValueError(f"it is not a CSV file: {error}") from error
    columns = [name.strip().lower() for name in rows[0]] if rows else []
    if columns.count("x") != 1 or columns.count("z") != 1:
        cloud = "; a point cloud needs terrain.start and terrain.end" if len(columns) > 2 else ""
        raise ValueError(f"a header with columns x and z is needed; it has {columns}{cloud}")
    places = columns.index("x"), columns.index("z")
    beside = columns.index("y") if columns.count("y") == 1 else len(columns)
    points: list[tuple[float, float, float]] = []
    numbers: list[int] = []
    for (number, _), row in zip(texts[1:], rows[1:], strict=False):
        if not any(text.strip() for text in row):
            continue  # spreadsheets write such lines at the end
        x, z = _point(row, number, len(columns), places, delimiter)
        y = _number(row[beside], delimiter) if beside < len(row) else None
        points.append((x, z, math.nan if y is None else y))
        numbers.append(number)
    return np.array(points).reshape(-1, 3), np.array(numbers, dtype=np.int64), len(columns)


def _point(
    row: list[str], number: int, columns: int, places: tuple[int, int], delimiter: str
) -> tuple[float, float]:
    """Return x and z of a line, which may be NaN."""
    if len(row) > columns and any(text.strip() for text in row[columns:]):
        raise ValueError(
            f"line {number}: it has {len(row)} values for {columns} columns; where the "
            "decimal sign is a comma, semicolons must separate the columns"
        )
    found = tuple(row[at] if at < len(row) else "" for at in places)
    x, z = (_number(text, delimiter) for text in found)
    if x is None or z is None:
        raise ValueError(f"line {number}: x and z must be numbers; they are {found}")
    return x, z


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


def _number(text: str, delimiter: str) -> float | None:
    """Return the number in ``text``, which may be NaN, or None if it is infinite or no number."""
    if delimiter != "," and "." not in text:
        text = text.replace(",", ".")
    try:
        number = math.inf if "_" in text else float(text)
    except ValueError:
        return None
    return None if math.isinf(number) else number


def _compiled(path: Path) -> tuple[FloatArray, NDArray[np.int64], int] | None:
    """Return what ``_rows`` does for a plain file, or None if ``_rows`` must read it.

    For plain tables of numbers this takes a fifth of the time and a tenth of the memory. Files with
    faults or missing heights give None, so that ``read_csv`` names the line.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            columns = [name.strip().lower() for name in file.readline().split(",")]
            if columns.count("x") != 1 or columns.count("z") != 1:
                return None
            used = [columns.index("x"), columns.index("z")]
            # All columns: with ``usecols``, numpy takes rows of another width without a word.
            table = np.loadtxt(file, delimiter=",", ndmin=2, comments=None)
    except ValueError:
        return None
    if len(table) < 2 or table.shape[1] != len(columns):
        return None
    points = table[:, used]
    y = table[:, columns.index("y")] if columns.count("y") == 1 else np.full(len(table), np.nan)
    _, missing = without_missing(points[:, 1])
    if missing or not np.isfinite(points).all():
        return None
    return np.column_stack([points, y]), np.arange(len(table)) + 2, len(columns)
