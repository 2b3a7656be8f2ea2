"""Strict JSON: keys are unique and numbers are finite."""

from __future__ import annotations

import json
import math
from typing import Any


def decode(text: str) -> dict[str, Any]:
    """Return the mapping of a JSON text whose keys are unique and whose numbers are finite.

    Raises:
        ValueError: the text is not such a mapping.
    """
    try:
        raw = json.loads(
            text,
            object_pairs_hook=_unique_keys,
            parse_constant=_refuse_constant,
            parse_float=_finite,
        )
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(raw, dict):
        raise ValueError(f"it must be a mapping; it is a {type(raw).__name__}")
    return raw


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        duplicate = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it holds the key {duplicate!r:.40} twice")
    return found


def _refuse_constant(constant: str) -> float:
    raise ValueError(f"it holds {constant}; finite numbers are allowed")


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse_constant(number[:40])
