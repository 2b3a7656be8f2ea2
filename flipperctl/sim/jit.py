"""Numba's decorators with a cache on disk wherever a folder is writable.

In a container or a service, neither the package's folder nor the home folder's cache may be
writable; numba then refuses to decorate. Such functions are cached in the temporary folder, and
without one every process compiles them again.
"""

from __future__ import annotations

import logging
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

_LOG = logging.getLogger(__name__)


def cached(decorator: Callable[..., Any], *arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's ``njit`` or ``cfunc``, with a cache if there is a folder for it."""

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return decorator(*arguments, cache=True)(function)
        except RuntimeError as error:  # numba found no writable folder
            folder = private_folder()
            _LOG.debug("%s; using %s", error, folder or "no cache: each process compiles anew")
            if folder is None:
                return decorator(*arguments)(function)
        vars(numba.config)["CACHE_DIR"] = str(
            folder
        )  # also for the functions that are decorated later
        try:
            return decorator(*arguments, cache=True)(function)
        except RuntimeError:  # the folder was deleted, or its file system is full
            return decorator(*arguments)(function)

    return decorate


def private_folder() -> Path | None:
    """Return this user's own folder for numba among the temporary files, or None without one.

    Numba unpickles the files in its cache, so no other user may be able to write there.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"
    try:
        folder = Path(tempfile.gettempdir()) / f"flipperctl-numba-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:  # the temporary folder is not writable, or a file is in its place
        return None
    if not stat.S_ISDIR(found.st_mode):
        return None
    if user != "user" and (found.st_uid != user or found.st_mode & 0o077):
        return None
    return folder
