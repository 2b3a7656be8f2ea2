"""Reads files that another process may replace, as a training replaces its policies."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
_ATTEMPTS = 10
_PAUSE = 0.05  # [s]


def read_whole(path: Path, parse: Callable[[bytes], T], refusal: type[Exception]) -> T:
    """Return what ``parse`` makes of the bytes of a file, which is opened once.

    If another process writes the file meanwhile, as a copy does, it is read again.

    Raises:
        OSError: the file cannot be read.
        refusal: ``parse`` raised it for a file that stays as it is, or the file does not.
    """
    for _ in range(_ATTEMPTS):
        before = _stamp(path)
        data = path.read_bytes()
        try:
            return parse(data)
        except refusal as error:
            refused = error
            # If the file has changed meanwhile, only half of it may have been refused.
            if _stamp(path) == before:
                raise
            time.sleep(_PAUSE)
    raise refusal(f"{path} is being replaced by another process; try again") from refused


def _stamp(path: Path) -> tuple[int, ...]:
    status = path.stat()
    return status.st_ino, status.st_size, status.st_mtime_ns
