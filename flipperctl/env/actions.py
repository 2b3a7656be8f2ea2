"""Checks that a value is an action, an index into ``flipperctl.api.ACTIONS``."""

from __future__ import annotations

import operator
from typing import Any

from flipperctl.api import ACTIONS

ALLOWED = f"an integer from 0 to {len(ACTIONS) - 1} is allowed"


def action_index(value: Any) -> int | None:
    """Return a value as an action index, or None if it is not one.

    Python's and numpy's integers and integer arrays without a dimension are accepted. Other
    numbers, booleans and arrays with a dimension are not, as for Gymnasium's Discrete.
    """
    if isinstance(value, bool):
        return None
    try:
        index = operator.index(value)
    except TypeError:
        return None
    return index if 0 <= index < len(ACTIONS) else None
