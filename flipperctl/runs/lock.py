"""The lock of a run or results directory: one process at a time works in it.

In: the directory. Out: a context in which this process holds the lock; a second process fails at
once with an error that names the holder. The operating system releases the lock when the
process dies; on a file system without locks, a lock file names the process.
"""

from __future__ import annotations

import errno
import itertools
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
"""Time to wait for the holder's note before the holder counts as unknown [s]."""


@contextmanager
def hold(directory: Path, name: str = "run", use: str = "being trained") -> Iterator[None]:
    """Hold the lock of an existing directory until the context ends or this process dies.

    ``name`` distinguishes the locks of one directory: a sweep and its only run may share one. The
    files ``.<name>.lock`` and ``.<name>.lock.json`` (a note on the holder) lie in the directory.
    The first is never removed: if it were removed while another process opens it, two processes
    could hold the lock. ``use`` describes the use of the directory in the error's text.

    Raises:
        RunHeldError: another process holds the lock; nothing was written.
        OutputError: the directory cannot be written.
    """
    path = directory / f".{name}.lock"
    note = directory / f".{name}.lock.json"
    try:
        lock = _acquire(path)
    except Timeout as error:
        raise RunHeldError(_held_text(directory, path, note, use)) from error
    except OSError as error:
        raise failure(path, error) from error
    try:
        write_json(note, holder())
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def names(directory: Path, *, numbered: bool) -> Iterator[Path]:
    """Yield the directory and, with ``numbered``, ``…_2``, ``…_3`` and so on beside it."""
    yield directory
    if numbered:
        yield from (directory.with_name(f"{directory.name}_{i}") for i in itertools.count(2))


def _acquire(path: Path) -> BaseFileLock:
    """Acquire a lock of the operating system, or a lock file where the file system has none."""
    with warnings.catch_warnings():
        # The library warns when it uses a lock file instead; the user need not act on that.
        warnings.simplefilter("ignore", UserWarning)
        try:
            lock: BaseFileLock = FileLock(path)
            lock.acquire(blocking=False)
        except OSError as error:  # a network file system without its lock service
            if isinstance(error, Timeout) or error.errno not in _UNSUPPORTED:
                raise
            lock = SoftFileLock(path.with_suffix(".softlock"))  # it replaces that of a dead process
            lock.acquire(blocking=False)
    return lock


def holder() -> dict[str, Any]:
    """Return the identifier and host of this process, and the time, for other processes."""
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    return {"pid": os.getpid(), "host": socket.gethostname(), "since": since}


def is_held(directory: Path, name: str = "run") -> bool:
    """Return whether a process works in the directory: one of here or of another machine.

    A note alone may be that of a dead process.
    """
    path = directory / f".{name}.lock"
    if not path.exists() and not path.with_suffix(".softlock").exists():
        return False
    try:
        _acquire(path).release()
    except (Timeout, OSError):  # a folder that may only be read has the note alone
        note = _note_now(directory / f".{name}.lock.json")
        return note is not None and not is_dead(note)
    return False


def _held_text(directory: Path, path: Path, note: Path, use: str) -> str:
    found = _read_note(note)
    if found is None:
        return f"{directory} is {use} by another process; wait for it, or stop it"
    soft = path.with_suffix(".softlock")
    advice = f" (if it is gone, delete {soft})" if soft.exists() else ""
    return (
        f"{directory} is {use} by process {found['pid']} on {found['host']} since "
        f"{found['since']}; wait for it, or stop it{advice}"
    )


def _read_note(note: Path) -> dict[str, Any] | None:
    """Return the holder's note; None if it does not appear in time.

    The holder writes its note after it has the lock, so the note may be missing or, after a crash,
    be that of a dead process.
    """
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        found = _note_now(note)
        if found is not None and not is_dead(found):
            return found
        time.sleep(0.02)
    return None


def _note_now(note: Path) -> dict[str, Any] | None:
    """Return the note that the file has now; None if it is missing or damaged."""
    try:
        found = json.loads(note.read_text())
        return dict(found) if {"pid", "host", "since"} <= found.keys() else None
    except (OSError, ValueError, AttributeError):  # missing, damaged or not a mapping
        return None


def is_dead(holder: dict[str, Any]) -> bool:
    """Return whether a process of this machine has ended; False if that is unknown."""
    if holder["host"] != socket.gethostname() or os.name != "posix":
        return False
    try:
        os.kill(int(holder["pid"]), 0)
    except (ProcessLookupError, TypeError, ValueError, OverflowError):
        return True
    except PermissionError:  # it runs under another user
        return False
    return False
