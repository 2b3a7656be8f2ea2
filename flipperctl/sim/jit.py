"""Numba's decorators with a cache on disk, if a folder is writable.

Containers and services may have no writable folder; every process then compiles again.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

from flipperctl.sim.code_cache import machine_code_folder

_LOG = logging.getLogger(__name__)


def cached(decorator: Callable[..., Any], *arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's ``njit`` or ``cfunc``, with a cache if there is a folder for it."""

    def decorate(function: Callable[..., Any]) -> Any:
        folder = machine_code_folder()
        if folder is None:
            _LOG.debug("no folder for machine code is writable: each process compiles anew")
            return decorator(*arguments)(function)
        try:
            with _cache_in(folder):
                return decorator(*arguments, cache=True)(function)
        except RuntimeError as error:  # the folder was deleted, or its file system is full
            _LOG.debug("%s; no cache: each process compiles anew", error)
            return decorator(*arguments)(function)

    return decorate


@contextlib.contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """Make numba cache the functions that are decorated in this block in ``folder``.

    Functions that other packages decorate later are cached in numba's default folder.
    """
    settings = vars(numba.config)
    before = settings["CACHE_DIR"]
    settings["CACHE_DIR"] = str(folder)
    try:
        yield
    finally:
        settings["CACHE_DIR"] = before
