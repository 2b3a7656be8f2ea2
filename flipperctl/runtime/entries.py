"""The entries of an exported policy's metadata: read as JSON, and checked.

In: the metadata of an ONNX model. Out: the value of an entry.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

from flipperctl.core.actions import PAIRS
from flipperctl.errors import PolicyError
from flipperctl.runtime.checksum import PREFIX


def read_entry(
    metadata: Mapping[str, str],
    where: str,
    name: str,
    allowed: str,
    check: Callable[[Any], bool],
    absent: str = "",
) -> Any:
    """Return the value of an entry after ``check``; ``absent`` is the text of a missing entry.

    Raises:
        PolicyError: the entry is not JSON, or ``check`` rejects it.
    """
    text = metadata.get(f"{PREFIX}{name}", absent)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    if value is None or not check(value):
        raise PolicyError(
            f"{where}: {PREFIX}{name} is {text[:60]!r} in its metadata; {allowed} is allowed"
        )
    return value


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_count(value: object) -> bool:
    """Return whether a value is a whole number above 0."""
    return isinstance(value, int) and is_whole(value) and value > 0


def is_number(value: object) -> bool:
    """Return whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max  # false for NaN; integers are unbounded


def is_positive(value: object) -> bool:
    """Return whether a value is a finite number above 0."""
    return isinstance(value, int | float) and is_number(value) and value > 0


def is_table(value: object) -> bool:
    """Return whether a value is a table with a row of finite numbers for each action."""
    return (
        isinstance(value, list)
        and len(value) == len(PAIRS.steps)
        and all(
            isinstance(row, list) and len(row) == len(PAIRS.joints) and all(map(is_number, row))
            for row in value
        )
    )
