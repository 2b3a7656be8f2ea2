"""Check that a file can hold what its header claims, before memory is allocated for it.

In: a point cloud file. Out: the number of its points, or an error.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_LONGEST_HEADER = 1000  # lines
_LONGEST_LINE = 100_000  # bytes
_MAX_VALUES = 1000
"""Largest number of values per point; PCL's own point types have a few hundred at most."""
_LZF_MAX_RATIO = 264
"""Largest number of bytes that one byte of LZF-compressed data can expand to."""


def pcd_points(path: Path) -> int:
    """Return the number of points in a PCD file's header.

    Raises:
        ValueError: the file cannot hold that many points, or the header is malformed.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header: dict[str, list[str]] = {}
        for line in _header(file):
            key, *words = line.split()
            header[key.upper()] = words
            if header.get("DATA"):
                break
        rest = size - file.tell()
        data = header.get("DATA", [""])[0].lower()
        sizes = _counts(header, "SIZE", len(header.get("FIELDS", [])))
        counts = _counts(header, "COUNT", len(sizes)) if "COUNT" in header else [1] * len(sizes)
        (points,) = _counts(header, "POINTS", 1)
        values = sum(counts)
        if values > _MAX_VALUES:
            raise ValueError(f"a point has {values} numbers; {_MAX_VALUES} are allowed")
        record = sum(width * count for width, count in zip(sizes, counts, strict=True))
        if data == "binary_compressed":
            packed, whole = (int.from_bytes(file.read(4), "little") for _ in range(2))
            if packed > rest - 8 or whole > packed * _LZF_MAX_RATIO or whole != points * record:
                raise ValueError(_claim(points, "points", size))
        elif points * (record if data == "binary" else 2 * values) > rest + 1:
            raise ValueError(_claim(points, "points", size))
    return points


def ply_vertices(path: Path) -> int:
    """Return the number of vertices in a PLY file's header.

    Raises:
        ValueError: the file cannot hold that many elements, or the header is malformed.
    """
    vertices = 0
    size = path.stat().st_size
    with path.open("rb") as file:
        for line in _header(file):
            key, *words = line.split()
            if key == "element" and len(words) == 2:
                count = _count(words[1], f"the number of {words[0][:20]} elements")
                if count > size:
                    raise ValueError(_claim(count, f"{words[0][:20]} elements", size))
                vertices = count if words[0] == "vertex" else vertices
            if key == "end_header":
                return vertices
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
