"""Tables of numbers in text files, as spreadsheets, scanners and programs write them.

In: a file whose columns are separated by semicolons, tabs, commas or blanks. Out: the columns x, y
and z with the numbers of their lines; an error names the line.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_COMMENTS = ("#", "//")
"""Beginnings of lines that are comments."""
_DECIMAL_COMMA = re.compile(r"[-+]?(\d+(,\d+)?(e[-+]?\d+)?|nan|inf)", re.IGNORECASE)
_Lines = list[tuple[int, str]]
"""Numbers of lines and their text."""


@dataclass(frozen=True)
class Table:
    """The columns of a file that were asked for."""

    values: FloatArray
    """(R, C) of each line with numbers and each column; NaN where a value is empty."""
    lines: NDArray[np.int64]
    """Number of each line in the file, (R,)."""
    names: list[str]
    """Names of all columns of the file by its header."""


def read_table(path: Path, needed: str, optional: str = "", *, headless: bool = False) -> Table:
    """Return the ``needed`` columns of a text file, such as "xz", and then the ``optional`` ones.

    A unit in brackets may follow a name. The decimal sign may be a comma, unless it separates the
    columns. Lines that begin with # or // are comments. An optional column that is missing is NaN.

    ``headless``: whether a file without a header has the needed columns first; a header may then be
    the comment before the first line.

    Raises:
        ValueError: the file is not text, its header does not name each needed column once, or a
            line holds anything but numbers.
    """
    texts = [(at, text.strip().replace('"', "")) for at, text in enumerate(read_lines(path), 1)]
    # Some spreadsheets write their separator first, and lines of separators alone at the end.
    texts = [(at, t) for at, t in texts if t.strip(";, \t") and not t.lower().startswith("sep=")]
    rows = [(at, text) for at, text in texts if not text.startswith(_COMMENTS)]
    first, text = rows[0] if rows else (1, "")
    begin = _split(text, _separator(text))
    comments = [text.lstrip("#/ ") for at, text in texts if at < first]
    if headless and _numbers(begin[: len(needed)]) is not None:
        names, width = _names(comments[-1]) if comments else [], None
        if len(names) != len(begin) or not _has(names, needed):
            names = [*needed]
    else:
        names, rows = _names(text), rows[1:]
        width = len(names)
    if not _has(names, needed):
        allowed = "numbers, or a header" if headless else "a header"
        raise ValueError(
            f"line {first}: {allowed} with columns {_listed(needed)} is needed; it has "
            f"{names[:10]}; a point cloud needs terrain.start and terrain.end, a .csv of x and z "
            "is a profile without these"
        )
    columns = [*map(names.index, needed)]
    columns += [names.index(name) for name in optional if names.count(name) == 1]
    values = np.full((len(rows), len(needed + optional)), np.nan)
    for row, numbers in enumerate(_read(rows, columns, width, needed)):
        values[row, : len(columns)] = numbers
    return Table(values, np.array([at for at, _ in rows], dtype=np.int64), names)


def read_lines(path: Path) -> list[str]:
    """Return the file's lines without their ends.

    A file without a byte order mark is read as UTF-8 or else as Windows-1252, which spreadsheets
    write.

    Raises:
        ValueError: the file is not text.
    """
    data = path.read_bytes()
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    for name in (encoding,) if encoding else ("utf-8", "cp1252"):
        try:
            text = data.decode(name)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.splitlines()
    raise ValueError("it is not a text file; it holds binary data")


def _read(
    rows: _Lines, columns: Sequence[int], width: int | None, needed: str
) -> Iterator[list[float]]:
    """Yield the numbers of the columns of each line, which has no more values than ``width``."""
    separator = _separator(rows[0][1]) if rows else ","
    for at, text in rows:
        values = _split(text, separator)
        if width is not None and any(values[width:]):
            raise ValueError(
                f"line {at}: it has {len(values)} values for {width} columns; where the decimal "
                "sign is a comma, semicolons must separate the columns"
            )
        used = [values[column] if column < len(values) else "-" for column in columns]
        numbers = _numbers(used)
        if numbers is None:
            raise ValueError(f"line {at}: {_listed(needed)} must be numbers; they are {(*used,)}")
        yield numbers


def _separator(text: str) -> str | None:
    """Return what separates the columns of a line; None: blanks."""
    if sign := next((sign for sign in ";\t" if sign in text), None):
        return sign
    values = text.split()
    decimal = len(values) > 2 and all(map(_DECIMAL_COMMA.fullmatch, values[:3]))
    return "," if "," in text and not decimal else None


def _split(text: str, separator: str | None) -> list[str]:
    """Return the values of a line; beside commas, blanks may separate some of them."""
    parts = text.split(separator)
    if separator == ",":
        return [value for part in parts for value in part.split() or [""]]
    return [value.strip() for value in parts]


def _names(header: str) -> list[str]:
    """Return the names of a header's columns, in lower case and without units."""
    header = re.sub(r"[\[(][^\])]*[\])]", "", header.lower())
    sign = next((sign for sign in ";\t," if sign in header), None)
    return [name.strip() for name in header.split(sign)] if header else []


def _has(names: Sequence[str], needed: str) -> bool:
    return all(names.count(name) == 1 for name in needed)


def _listed(needed: str) -> str:
    return f"{', '.join(needed[:-1])} and {needed[-1]}"


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """Return the numbers of texts, NaN of an empty one; None if one is no number."""
    if any("_" in text for text in texts):  # which Python allows
        return None
    texts = [text if "." in text else text.replace(",", ".") for text in texts]
    try:
        return [float(text) if text else math.nan for text in texts]
    except ValueError:
        return None
