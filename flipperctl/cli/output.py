"""Handle a standard output that cannot be written: a full disk or a closed pipe."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from typing import TextIO

_BROKEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}


def failure_reason(error: Exception) -> str:
    """Return why standard output could not be written, or an empty text for any other error.

    Files are written by ``flipperctl.files``, which raises flipperctl's own errors.
    """
    if isinstance(error, OSError) and error.filename is None and error.errno in _BROKEN:
        return os.strerror(error.errno)
    return ""


def flush() -> OSError | None:
    """Flush standard output and standard error; return the first error, if any."""
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
    """Redirect the stream to null, so that the interpreter's last flush prints no error."""
    with contextlib.suppress(OSError, ValueError):  # a test's stream has no descriptor
        sink = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, stream.fileno())
        finally:
            os.close(sink)
