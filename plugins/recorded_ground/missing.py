"""Values that stand for unknown heights in files.

In: numbers as a file holds them. Out: the same with NaN in place of those values.
"""

import numpy as np

from flipperctl.api import FloatArray

TYPICAL = (-9999.0, -99999.0, -32767.0, -32768.0)
"""Values that mapping programs write for unknown heights [the file's unit]."""
_HUGE = 1e20
"""Smallest absolute value that is no height, such as 1e20 and 3.4e38 [the file's unit]."""


def without_missing(values: FloatArray, stated: float | None = None) -> tuple[FloatArray, str]:
    """Return the values with NaN for missing ones, and a remark on those found unstated.

    Besides ``stated``, typical and huge values are missing; without these the remark is empty.
    """
    if stated is not None:
        values = np.where(values == np.float64(stated), np.nan, values)
    found = np.isin(values, TYPICAL) | (np.abs(values) >= _HUGE)  # NaN is neither
    if not found.any():
        return values, ""
    first = values[found].ravel()[0]
    remark = f"{int(found.sum())} values such as {first:g} are treated as unknown heights"
    return np.where(found, np.nan, values), remark
