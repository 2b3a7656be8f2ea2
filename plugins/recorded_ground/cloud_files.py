"""Read point clouds from PCD, PLY and text files.

In: a file. Out: its points as they are stored, and what the file states about them.
"""

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flipperctl.api import FloatArray

from .claims import Pose, pcd_header, ply_elements
from .text import read_lines

_DECIMAL_COMMA = re.compile(r"[-+]?(\d+(,\d+)?(e[-+]?\d+)?|nan|inf)", re.IGNORECASE)
_COMMENTS = ("#", "//")
"""Beginnings of lines that are comments."""


@dataclass(frozen=True)
class CloudFile:
    """The points of a file."""

    points: FloatArray
    """(P, 3) in the frame and unit of the file; not finite where a ray did not return."""
    single: bool = False
    """Whether the coordinates are stored in single precision."""
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
    single = all(cloud.pc_data.dtype[axis] == np.float32 for axis in "xyz")
    return CloudFile(_complete(points, header.points), single, header.pose)


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
    return CloudFile(_complete(points, claimed), vertices.dtype == np.float32)


def _complete(points: FloatArray, claimed: int) -> FloatArray:
    if points.shape != (claimed, 3):
        raise ValueError(f"its header claims {claimed} points (x, y, z); it holds {points.shape}")
    return points


def read_text(path: Path) -> CloudFile:
    """Read the columns x, y and z of a text file; without a header, these are the first three.

    Columns are separated by blanks, commas, semicolons or tabs. The decimal sign may be a comma,
    unless it separates the columns. An empty value is NaN.

    Raises:
        ValueError: the file is not text, its header names no x, y and z, or a line does not hold
            three numbers.
    """
    lines = [
        (number, text.strip().replace('"', ""))
        for number, text in enumerate(read_lines(path), start=1)
        if text.strip() and not text.lower().startswith("sep=")  # the line of some spreadsheets
    ]
    used = [(number, text) for number, text in lines if not text.startswith(_COMMENTS)]
    if not used:
        raise ValueError("it holds no points")
    first = used[0][0]
    columns: tuple[int, ...] = (0, 1, 2)
    before = [text for number, text in lines if number < first]
    if _numbers(used[0][1], columns) is None:
        columns = _named(first, used.pop(0)[1])
    elif before:  # a header may be a comment that names each column
        columns = _places(before[-1].lstrip("#/ "), len(_split(used[0][1]))) or columns
    try:
        texts = (" ".join(_split(text)) for _, text in used)
        points = np.loadtxt(texts, usecols=columns, ndmin=2)
    except ValueError:
        points = np.array(list(_each(used, columns))).reshape(-1, 3)
    return CloudFile(points)


def _each(lines: list[tuple[int, str]], columns: tuple[int, ...]) -> Iterator[list[float]]:
    """Yield the numbers of each line, (3,); an error names the line."""
    for number, text in lines:
        numbers = _numbers(text, columns)
        if numbers is None:
            raise ValueError(f"line {number}: x, y and z must be numbers; it is {text[:60]!r}")
        yield numbers


def _numbers(text: str, columns: tuple[int, ...]) -> list[float] | None:
    """Return the numbers in a line's columns, (3,), or None if they are none."""
    values = _split(text)
    try:
        return [float(values[at]) for at in columns]
    except (ValueError, IndexError):
        return None


def _named(number: int, header: str) -> tuple[int, ...]:
    """Return the columns x, y and z that a header names.

    Raises:
        ValueError: it does not name each of them once.
    """
    columns = _places(header)
    if columns is None:
        raise ValueError(
            f"line {number}: three numbers, or a header that names x, y and z, are needed; it is "
            f"{header[:60]!r} (a .csv of x and z is a profile, without start and end)"
        )
    return columns


def _places(header: str, count: int | None = None) -> tuple[int, ...] | None:
    """Return the places of x, y and z among a header's columns; a unit may follow a name.

    None if they are not named, or if the header has other than ``count`` columns.
    """
    header = re.sub(r"[\[(][^\])]*[\])]", "", header.lower())
    sign = next((sign for sign in ";\t," if sign in header), None)
    names = [name.strip() for name in header.split(sign)]
    if count not in (None, len(names)) or any(names.count(axis) != 1 for axis in "xyz"):
        return None
    return tuple(map(names.index, "xyz"))


def _split(line: str) -> list[str]:
    """Return a line's values with decimal points; an empty one is NaN."""
    values = line.split()
    if ";" in line:
        values = [text.strip().replace(",", ".") or "nan" for text in line.split(";")]
    elif len(values) > 2 and all(map(_DECIMAL_COMMA.fullmatch, values[:3])):
        values = [text.replace(",", ".") for text in values]
    elif "," in line:
        values = [one for text in line.split(",") for one in text.split() or ["nan"]]
    return values
