"""Standard output that cannot be written: a full disk, or a reader that has left."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from typing import TextIO

_BROKEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}


def failure_reason(error: Exception) -> str:
    """Why standard output took no more, if that is what ``error`` says; else nothing.

    Our own files are written by ``run.files``, whose errors are flipperctl's.
    """
    if isinstance(error, OSError) and error.filename is None and error.errno in _BROKEN:
        return os.strerror(error.errno)
    return ""


def flush() -> OSError | None:
    """Write what is left for standard output and error; returns why that failed, if it did."""
    first: OSError | None = None
    for stream in (sys.stdout, sys.stderr):
        if stream is None or stream.closed:
            continue
        try:
            stream.flush()
        except OSError as error:
            first = first or error
            _discard(stream)
    return first


def _discard(stream: TextIO) -> None:
    """Let the interpreter's last flush succeed: it would print an error of its own."""
    with contextlib.suppress(OSError, ValueError):  # a stream of a test has no descriptor
        sink = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, stream.fileno())
        finally:
            os.close(sink)
