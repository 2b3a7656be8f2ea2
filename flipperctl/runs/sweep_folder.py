"""The folder of each run of a sweep, named after the swept values."""

from __future__ import annotations

import re
from collections.abc import Mapping

_LONGEST = 120
"""Largest length of a folder's name in characters; file systems allow 255 bytes."""


def folder_name(number: int, swept: Mapping[str, str]) -> str:
    """Return the folder name of a sweep's run, as in ``0_seed=1,terrain=step``.

    Characters that are special to a shell or a file system become ``_``; a long name is cut.
    """
    words = ",".join(f"{key}={_short(value)}" for key, value in swept.items())
    name = re.sub(r"[^A-Za-z0-9_.,=+-]+", "_", f"{number}_{words}")
    return name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "_"


def _short(value: str) -> str:
    """Return a number with five digits, since a search samples sixteen; keep other values."""
    try:
        return value if len(value) <= 8 else f"{float(value):.5g}"
    except ValueError:
        return value
