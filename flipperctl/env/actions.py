"""What counts as an action: an index into ``flipperctl.api.ACTIONS``."""

from __future__ import annotations

import operator
from typing import Any

from flipperctl.api import ACTIONS

ALLOWED = f"an integer from 0 to {len(ACTIONS) - 1} is allowed"


def action_index(value: Any) -> int | None:
    """The index that a value is, or None.

    Python's and numpy's integers are one, and so is an array of one integer without a dimension.
    Other numbers, truth values and arrays with a dimension are none, as for Gymnasium's Discrete.
    """
    if isinstance(value, bool):
        return None
    try:
        index = operator.index(value)
    except TypeError:
        return None
    return index if 0 <= index < len(ACTIONS) else None
