"""Numba's decorators with a cache on disk, one folder for each version of the compiled sources.

Numba compiles a function again when the file that defines it changes. It does not notice changes in
functions and constants of other files that are compiled into it. Nor does it notice a change in a
library whose structs compiled code reads by their offsets. Therefore a digest of all of these is
part of the folder's name. Without a writable folder, every process compiles again.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from numba import types

PACKAGE = Path(__file__).parents[1]
SOURCES = ("api", "core", "lookahead", "sim")
"""Folders of the package that hold all functions and constants in compiled code."""
_NAME = "machine_code"
_KEPT = 4  # number of folders of other digests that are kept


@cache
def machine_code_folder() -> Path | None:
    """Return the writable folder for the current digest, or None without one.

    It lies in the folder that ``NUMBA_CACHE_DIR`` names, or else beside the package's byte code, or
    in the user's cache. A few folders of earlier digests are kept.
    """
    digest = code_digest((PACKAGE / name for name in SOURCES), _libraries())
    for base in _bases():
        folder = base / _NAME / digest
        try:
            # Only writing shows whether a folder is writable; its new time of use spares it from
            # removal.
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            os.utime(folder)
        except OSError:  # it is not writable, or full
            continue
        _remove_unused(folder)
        return folder
    return None


def code_digest(folders: Iterable[Path], libraries: Iterable[Path]) -> str:
    """Return a digest of the Python files in folders, of libraries' files and of versions."""
    digest = hashlib.sha256()
    versions = (sys.version, numba.__version__, llvmlite.__version__, np.__version__)
    digest.update(repr(versions).encode())
    sources = [
        (p, p.relative_to(folder)) for folder in folders for p in sorted(folder.rglob("*.py"))
    ]
    # Name and length keep two sets of files apart whose contents join to the same bytes.
    for path, name in (*sources, *((path, Path(path.name)) for path in libraries)):
        content = path.read_bytes()
        digest.update(f"{name.as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def _libraries() -> list[Path]:
    """Return pymunk's version and its compiled library, whose functions and structs are used."""
    spec = importlib.util.find_spec("pymunk")
    places = [Path(place) for place in (spec and spec.submodule_search_locations) or ()]
    return [path for place in places for path in sorted(place.glob("_chipmunk*")) if path.is_file()]


def _bases() -> Sequence[Path]:
    if configured := vars(numba.config)["CACHE_DIR"]:
        return [Path(configured)]
    cache = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return PACKAGE / "__pycache__", Path(cache) / "flipperctl"


def c_function(name: str, address: int, signature: Any) -> Any:
    """Return a C function at an address, for calls from compiled code."""
    llvmlite.binding.add_symbol(name, address)
    return types.ExternalFunction(name, signature)


def _remove_unused(used: Path) -> None:
    """Remove folders of other digests but the newest; a process that uses one compiles again."""
    with contextlib.suppress(OSError):  # another process may remove them at the same time
        others = [path for path in used.parent.iterdir() if path != used]
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        for path in others[_KEPT:]:
            shutil.rmtree(path, ignore_errors=True)


_LOG = logging.getLogger(__name__)


def cached(decorator: Callable[..., Any], *arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's ``njit`` or ``cfunc``, with a cache if there is a folder for it."""

    def decorate(function: Callable[..., Any]) -> Any:
        folder, settings = machine_code_folder(), vars(numba.config)
        reason = "no folder for machine code is writable"
        if folder is not None:
            # Numba takes the folder from a setting of the process, which other packages use as
            # well.
            before, settings["CACHE_DIR"] = settings["CACHE_DIR"], str(folder)
            try:
                return decorator(*arguments, cache=True)(function)
            except RuntimeError as error:  # the folder was deleted, or its file system is full
                reason = f"{error}; no cache"
            finally:  # functions that other packages decorate are cached in numba's own folder
                settings["CACHE_DIR"] = before
        _LOG.debug("%s: each process compiles anew", reason)
        return decorator(*arguments)(function)

    return decorate
