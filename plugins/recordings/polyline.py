"""Profiles that are written down point by point."""

import csv
from pathlib import Path

import numpy as np

from flipperctl.api import FloatArray

_LARGE = 1 << 20
"""A file from this size on is read by numpy's compiled reader first [bytes]."""


def read_csv(path: Path) -> FloatArray:
    """Columns ``x`` and ``z`` of a CSV file with a header, (V, 2) in the file's unit.

    Raises:
        ValueError: a column is missing, or a line holds no number or goes back in x.
    """
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        columns = [name.strip().lower() for name in reader.fieldnames or ()]
        if not {"x", "z"} <= set(columns):
            raise ValueError(f"a header with columns x and z is needed; it has {columns}")
        if path.stat().st_size >= _LARGE and (fast := _compiled(path, columns)) is not None:
            return fast
        reader.fieldnames = columns
        points: list[tuple[float, float]] = []
        for row in reader:
            try:
                x, z = float(row["x"]), float(row["z"])
            except (TypeError, ValueError) as error:
                found = (row["x"], row["z"])
                raise ValueError(
                    f"line {reader.line_num}: x and z must be numbers; they are {found}"
                ) from error
            if points and x < points[-1][0]:
                raise ValueError(
                    f"line {reader.line_num}: x goes back from {points[-1][0]:g} to {x:g}; "
                    "it may only grow or stay"
                )
            points.append((x, z))
    if len(points) < 2:
        raise ValueError(f"at least two points are needed; it has {len(points)}")
    return np.array(points)


def _compiled(path: Path, columns: list[str]) -> FloatArray | None:
    """Return what ``read_csv`` does, or None where only it can say what is wrong."""
    used = [len(columns) - 1 - columns[::-1].index(name) for name in ("x", "z")]
    try:
        points = np.loadtxt(
            path,
            delimiter=",",
            skiprows=1,
            usecols=used,
            ndmin=2,
            comments=None,
            quotechar='"',
            encoding="utf-8",
        )
    except ValueError:
        return None
    rising = len(points) >= 2 and not (np.diff(points[:, 0]) < 0).any()
    return points if rising else None
