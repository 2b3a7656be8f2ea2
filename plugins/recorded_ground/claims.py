"""Check that a file can hold what its header claims, before memory is allocated for it.

In: a point cloud file. Out: what its header states, or an error.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_LONGEST_HEADER = 1000  # lines
_LONGEST_LINE = 100_000  # bytes
_MAX_VALUES = 1000
"""Largest number of values per point; PCL's own point types have a few hundred at most."""
_LZF_MAX_RATIO = 264
"""Largest number of bytes that one byte of LZF-compressed data can expand to."""


Pose = tuple[float, ...]
"""Place (x, y, z) and quaternion (w, x, y, z) of a sensor, (7,)."""
_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PcdHeader:
    """The header of a PCD file."""

    text: str
    """The header without its pose and without the fields that have no numbers."""
    begin: int
    """Position of the data in the file [bytes]."""
    points: int
    """Number of points [-]."""
    pose: Pose | None
    """The pose that VIEWPOINT states, unless it is the identity."""


def pcd_header(path: Path) -> PcdHeader:
    """Return a PCD file's header.

    Raises:
        ValueError: the file cannot hold its points, or the header is malformed.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header: dict[str, list[str]] = {}
        for line in _header(file):
            key, *words = line.split()
            header[key.upper()] = words
            if header.get("DATA"):
                break
        begin = file.tell()

        # Fields and counts, as the header states them
        fields = header.get("FIELDS", [])
        sizes = _counts(header, "SIZE", len(fields))
        counts = _counts(header, "COUNT", len(sizes)) if "COUNT" in header else [1] * len(sizes)
        (points,) = _counts(header, "POINTS", 1)
        if (values := sum(counts)) > _MAX_VALUES:
            raise ValueError(f"a point has {values} numbers; {_MAX_VALUES} are allowed")
        types, data = header.get("TYPE", []), header.get("DATA", [""])[0].lower()
        known = all(fields.count(axis) == 1 for axis in "xyz")
        if not known or len(types) != len(fields) or not {*types} <= {*"FIU"}:
            raise ValueError(
                f"FIELDS are {' '.join(fields)[:80]!r} in its header and TYPE is "
                f"{' '.join(types)[:40]!r}; x, y and z, and F, I or U for each field, are needed"
            )
        if data not in ("ascii", "binary", "binary_compressed"):
            raise ValueError(
                f"DATA is {data[:40]!r} in its header; ascii, binary and binary_compressed are read"
            )

        # The file must hold the points, or their compressed bytes.
        record = sum(width * count for width, count in zip(sizes, counts, strict=True))
        if data == "binary_compressed":
            packed, whole = (int.from_bytes(file.read(4), "little") for _ in range(2))
            fits = packed <= size - begin - 8 and whole <= packed * _LZF_MAX_RATIO
            fits &= whole == points * record
        else:
            fits = points * (record if data == "binary" else 2 * values) <= size - begin + 1
        if not fits:
            raise ValueError(_claim(points, "points", size))

    # A header for the reader, without the fields that have no numbers
    rows: dict[str, Sequence[object]] = {
        "FIELDS": fields,
        "SIZE": sizes,
        "TYPE": types,
        "COUNT": counts,
    }
    lines = [
        " ".join([key, *(str(value) for value, count in zip(row, counts, strict=True) if count)])
        for key, row in rows.items()
    ]
    text = "\n".join(
        ["VERSION 0.7", *lines, f"WIDTH {points}", "HEIGHT 1", f"POINTS {points}", f"DATA {data}\n"]
    )
    return PcdHeader(text, begin, points, _pose(header.get("VIEWPOINT", [])))


def _pose(words: list[str]) -> Pose | None:
    """Return the pose of a VIEWPOINT; NaN states none, and a quaternion of 0 no turn.

    Raises:
        ValueError: it is not 7 numbers.
    """
    if not words:
        return None
    try:
        pose = tuple(float(word) for word in words)
    except ValueError:
        pose = ()
    if len(pose) != len(_IDENTITY):
        raise ValueError(
            f"VIEWPOINT is {' '.join(words)[:60]!r} in its header; 7 numbers are needed (x y z and "
            "the quaternion w x y z)"
        )
    if not all(map(math.isfinite, pose)):
        return None
    norm = math.hypot(*pose[3:])
    turn = [value / norm for value in pose[3:]] if norm > 0 else _IDENTITY[3:]
    moved = any(pose[:3]) or abs(turn[0]) < 1 - 1e-9
    return (*pose[:3], *turn) if moved else None


def ply_elements(path: Path) -> dict[str, int]:
    """Return the number of each kind of element in a PLY file's header.

    Raises:
        ValueError: the file cannot hold that many elements, or the header is malformed.
    """
    elements: dict[str, int] = {}
    size = path.stat().st_size
    with path.open("rb") as file:
        for line in _header(file):
            key, *words = line.split()
            if key == "element" and len(words) == 2:
                count = _count(words[1], f"the number of {words[0][:20]} elements")
                if count > size:
                    raise ValueError(_claim(count, f"{words[0][:20]} elements", size))
                elements[words[0]] = count
            if key == "end_header":
                return elements
    raise ValueError("its header has no end")


def _header(file: BinaryIO) -> Iterator[str]:
    """Yield the header's lines, without blank lines and comments."""
    for _ in range(_LONGEST_HEADER):
        raw = file.readline(_LONGEST_LINE)
        if not raw:
            return
        line = raw.decode("ascii", errors="replace").strip()
        if line and not line.startswith("#"):
            yield line


def _counts(header: dict[str, list[str]], key: str, length: int) -> list[int]:
    values = header.get(key, [])
    if len(values) != length or not values:
        raise ValueError(f"its header has no {key} of {max(1, length)} whole numbers")
    return [_count(value, key) for value in values]


def _count(text: str, what: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 20):
        raise ValueError(f"{what} is {text[:40]!r} in its header; a whole number is needed")
    return int(text)


def _claim(count: int, what: str, size: int) -> str:
    return f"its header claims {count} {what}, more than a file of {size} bytes can hold"
