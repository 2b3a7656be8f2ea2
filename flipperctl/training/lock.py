"""One process at a time works in a run directory.

In: the directory. Out: a context in which this process holds it; a second process is refused at
once and told who holds it. The lock is the operating system's, so a process that dies, in whatever
way, lets go of it; where a file system offers none, a lock file that names its process stands in.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from filelock import BaseFileLock, FileLock, SoftFileLock, Timeout

from flipperctl.errors import RunHeldError
from flipperctl.files import failure, write_json

_UNSUPPORTED = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP}
_PATIENCE = 1.0
"""Time that a holder has to say who it is, before it is called unknown [s]."""


@contextmanager
def hold(directory: Path, name: str = "run") -> Iterator[None]:
    """Hold ``directory``, which exists, until the context ends or this process dies.

    ``name`` tells locks of one directory apart: a sweep may lie where its only run lies. The files
    ``.<name>.lock`` and ``.<name>.lock.json`` (who holds it) lie in the directory; the first stays
    there, since to remove a lock that others may be opening would let two of them in.

    Raises:
        RunHeldError: another process holds it; nothing was written.
        OutputError: the directory cannot be written.
    """
    path = directory / f".{name}.lock"
    note = directory / f".{name}.lock.json"
    try:
        lock = _acquire(path)
    except Timeout as error:
        raise RunHeldError(_refusal(directory, path, note)) from error
    except OSError as error:
        raise failure(path, error) from error
    try:
        write_json(note, _holder())
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def _acquire(path: Path) -> BaseFileLock:
    """A lock of the operating system; a lock file where the file system has none."""
    with warnings.catch_warnings():
        # The library says so when it stands a lock file in for the lock; nobody need act on it.
        warnings.simplefilter("ignore", UserWarning)
        try:
            lock: BaseFileLock = FileLock(path)
            lock.acquire(blocking=False)
        except OSError as error:  # a network file system without its lock service
            if isinstance(error, Timeout) or error.errno not in _UNSUPPORTED:
                raise
            lock = SoftFileLock(path.with_suffix(".softlock"))  # one of a dead process is broken
            lock.acquire(blocking=False)
    return lock


def _holder() -> dict[str, Any]:
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    return {"pid": os.getpid(), "host": socket.gethostname(), "since": since}


def _refusal(directory: Path, path: Path, note: Path) -> str:
    holder = _read(note)
    if holder is None:
        return f"{directory} is being trained by another process; wait for it, or stop it"
    soft = path.with_suffix(".softlock")
    left = f" (if it is gone, delete {soft})" if soft.exists() else ""
    return (
        f"{directory} is being trained by process {holder['pid']} on {holder['host']} since "
        f"{holder['since']}; wait for it, or stop it{left}"
    )


def _read(note: Path) -> dict[str, Any] | None:
    """What the holder wrote of itself; None if it does not in time.

    It writes after it has the lock, so the note may be missing or, after a crash, that of a
    process that is dead.
    """
    patience = time.monotonic() + _PATIENCE
    while time.monotonic() < patience:
        try:
            found = json.loads(note.read_text())
            if {"pid", "host", "since"} <= found.keys() and not _dead(found):
                return dict(found)
        except (OSError, ValueError, AttributeError):  # not there, damaged, not a mapping
            pass
        time.sleep(0.02)
    return None


def _dead(holder: dict[str, Any]) -> bool:
    if holder["host"] != socket.gethostname() or os.name != "posix":
        return False
    try:
        os.kill(int(holder["pid"]), 0)
    except (ProcessLookupError, TypeError, ValueError, OverflowError):
        return True
    except PermissionError:  # it lives, and is another user's
        return False
    return False
