"""Writes files atomically; reads tables, and names file and line of what cannot be read."""

from __future__ import annotations

import contextlib
import csv
import errno
import glob
import io
import json
import mmap
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from flipperctl.errors import FlipperctlError, OutputError, RequestError, WriteError
from flipperctl.text.messages import close_match

_PART = ".part"
_RAN_OUT = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


_HOME = re.compile(r"""(?:^|(?<=[=,:[("']))~(?:(?=/|$)|[\w.-]+(?=/))""")
"""A ~ or ~user that begins a path: a whole word, the value of a setting, or one of a list."""


def at_home(value: Any) -> Any:
    """Return the value with the home folder for each ``~`` that begins a path in its texts.

    The shell leaves them where they begin no word, as in ``--output=~/runs``. This is called on
    all that comes in: words of a command, arguments from Python, variables of the environment,
    settings of any file. ``~user`` stays if there is no such user.
    """
    if isinstance(value, str):
        return _HOME.sub(lambda match: os.path.expanduser(match[0]), value)  # noqa: PTH111
    if isinstance(value, Path):
        return Path(at_home(str(value)))
    if type(value) in (list, tuple):
        return type(value)(map(at_home, value))
    if type(value) is dict:
        return {key: at_home(inner) for key, inner in value.items()}
    return value


@dataclass(frozen=True)
class OutputKind:
    """A kind of file that a command writes to a path of the user's choice."""

    noun: str
    """With its article, for errors."""
    suffixes: tuple[str, ...]
    """Lower-case suffixes of such files."""
    mark: re.Pattern[bytes]
    """Found in every such file that flipperctl wrote, and in no other file."""


def write_bytes(path: Path, data: bytes) -> None:
    """Replace the content of ``path`` by ``data`` atomically.

    If several processes write at once, the last to finish wins. A process that is killed may leave
    its partial file, whose name no other process uses; see ``remove_partial``.

    Raises:
        OutputError: the path cannot be written.
        WriteError: writing failed half way; an earlier file, if there is one, is kept.
    """
    write_chunks(path, [data])


def write_chunks(path: Path, chunks: Iterable[bytes]) -> None:
    """Replace the content of ``path`` by the chunks in turn, atomically; see ``write_bytes``.

    A link stays one: the file that it names is replaced.
    """
    path = Path(os.path.realpath(path)) if path.is_symlink() else path  # a loop stays as it is
    part = _part(path)
    try:
        with part.open("xb") as file:
            file.writelines(chunks)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True) if path.parent.is_dir() else None
        raise failure(path, error, keeps_old=path.exists()) from error


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}{_PART}")


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Let the body write a folder of the name of ``path``, which stands there once it is whole.

    Nothing is left of one whose body fails or is interrupted.
    """
    part = _part(path)
    try:
        part.mkdir()
        yield part / path.name
        (part / path.name).replace(path)
    except OSError as error:
        raise failure(path, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def remove_partial(path: Path) -> None:
    """Remove the partial files of killed processes; no other process may be writing ``path``."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*{_PART}"):
        part.unlink(missing_ok=True)


def write_json(path: Path, document: Any) -> None:
    """Replace the content of ``path`` by a JSON document; see ``write_bytes``."""
    write_bytes(path, (json.dumps(document, indent=2) + "\n").encode())


def write_csv(
    path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None
) -> None:
    """Replace the content of ``path`` by a header and rows; see ``write_bytes``.

    ``columns``: columns to write, in this order; None: every column that occurs in a row.
    """
    names = columns or list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(path, text.getvalue().encode())


class CsvRow(dict[str, str]):
    """A row of a table as text by column, and its place."""

    where: str
    """File and line, for errors."""

    def number(self, column: str) -> float:
        """Return the number in a column.

        Raises:
            RequestError: the text there is none.
        """
        try:
            return float(self[column])
        except ValueError:
            raise self.refusal(column, "a number is allowed") from None

    def refusal(self, column: str, text: str) -> RequestError:
        """Return the error for what a column has."""
        return RequestError(f"{self.where}: {column}: {text}; the value is {self[column]!r:.40}")


def read_csv(
    path: Path, needed: Collection[str] = (), renamed: Mapping[str, str] = MappingProxyType({})
) -> list[CsvRow]:
    """Return the rows of a table in UTF-8, with or without a byte order mark.

    ``renamed``: new names of columns by the old ones, which older tables have.

    Blank lines count as none. A last row that is cut off, as while it is written, is left out.

    Raises:
        RequestError: the file cannot be read, lacks a column of ``needed`` or has one twice, or has
            a row with another number of cells than its header.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
        lines = csv.reader(io.StringIO(text, newline=""), strict=True)
        header = [renamed.get(name, name) for name in next(lines, [])]
        if twice := {name for name in header if header.count(name) > 1}:
            raise RequestError(f"{path}, line 1: a column is named twice: {', '.join(twice)}")
        # Columns are checked before rows, so that a wrong file is named by its header.
        for name in needed:
            if name not in header:
                raise RequestError(
                    f"{path}, line 1: there is no column {name!r}{close_match(name, header)}; "
                    f"names separated by commas are allowed; it has {','.join(header)!r:.60}"
                )
        # A short last row without an end of line is one that is being written.
        rows = []
        for cells in filter(None, lines):
            row = CsvRow(zip(header, cells, strict=False))
            row.where = f"{path}, line {lines.line_num}"
            if len(cells) != len(header):
                if len(cells) < len(header) and not text.endswith("\n") and not any(lines):
                    break
                raise RequestError(f"{row.where}: {len(cells)} cells in {len(header)} columns")
            rows.append(row)
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RequestError(f"{path} is not text in UTF-8: {error}") from error
    except csv.Error as error:
        raise RequestError(f"{path}, line {lines.line_num}: {error}") from error
    return rows


def make_folder(path: Path) -> Path:
    """Return the folder ``path``, created if it does not exist."""
    if path.is_file():
        raise OutputError(f"{path} cannot be written: it is a file; a folder is allowed")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise failure(path, error) from error
    if not os.access(path, os.W_OK):
        raise OutputError(f"{path} cannot be written: permission denied")
    return path


def check_output(path: Path, kind: OutputKind) -> None:
    """Check, before long work, that an output can be written to ``path``.

    This is the rule for every file that a user names. It has a suffix of its kind, and an existing
    file is replaced only if it is empty or an earlier output of the same kind. So neither an input
    nor a file of another program is lost.

    Raises:
        OutputError: the suffix is another, the path cannot be written, or its file is kept.
    """
    # What stands in the way of any file
    if path.is_dir():
        raise OutputError(f"{path} cannot be written: it is a folder")
    if not path.parent.is_dir():
        raise OutputError(f"{path} cannot be written: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise OutputError(f"{path} cannot be written: permission denied")

    # What stands in the way of this kind of file
    suffix, suffixes = path.suffix.lower(), kind.suffixes
    if suffix not in suffixes:
        allowed = ", ".join(suffixes[:-1]) + " or " * (len(suffixes) > 1) + suffixes[-1]
        raise OutputError(
            f"{path}: {kind.noun} is a {allowed} file; the suffix is {path.suffix!r}"
            + close_match(suffix, suffixes)
        )

    # What would be lost
    if path.exists() and not _is_of(path, kind):
        raise OutputError(
            f"{path} exists and is kept, since it is not {kind.noun} that flipperctl wrote; move "
            "it, or choose another name"
        )


def _is_of(path: Path, kind: OutputKind) -> bool:
    """Return whether a file is empty or has the mark of its kind."""
    if not path.is_file():
        return False  # a device or a pipe
    try:
        with path.open("rb") as file:
            if not os.fstat(file.fileno()).st_size:
                return True
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return kind.mark.search(content) is not None
    except OSError:
        return False  # what cannot be read may be anything


def failure(path: Path, error: OSError, *, keeps_old: bool = False) -> FlipperctlError:
    """Return the exception to raise for an error of the operating system at ``path``.

    ``keeps_old``: an earlier file exists and is unchanged.
    """
    reason = os.strerror(error.errno) if error.errno else str(error)
    if error.errno in _RAN_OUT:
        remainder = "; the old file is kept" if keeps_old else ""
        return WriteError(f"{path}: writing failed half way ({reason}){remainder}")
    return OutputError(f"{path} cannot be written: {reason}")
