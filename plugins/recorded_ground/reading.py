"""Reading files of recorded ground: missing values, rounding, readers' warnings."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.core.crosschecks import Peak, compared, rounding

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
    missing = np.isin(values, TYPICAL) | (np.abs(values) >= _HUGE)  # NaN is neither
    if not missing.any():
        return values, ""
    first = values[missing].ravel()[0]
    remark = f"{int(missing.sum())} values such as {first:g} are treated as unknown heights"
    return np.where(missing, np.nan, values), remark


def known_heights(values: FloatArray, stated: float | None, unit: float) -> tuple[FloatArray, str]:
    """Return the heights of a map as ``without_missing``, whose format may round them too.

    ``unit``: of the values [m], for the remark.
    """
    heights, missing = without_missing(values, stated)
    step = unit * rounding(heights[np.isfinite(heights)], whole=True)
    (rounded,) = compared("its heights", heights_rounding=Peak(step))
    return heights, "; ".join(
        filter(None, (missing, "" if rounded.verdict == "ok" else rounded.sentence()))
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Raise the warnings of readers as errors and silence their logs.

    A logger that has a handler does not write to stderr.
    """
    for name in ("rasterio", "trimesh"):
        logger = logging.getLogger(name)
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # addressed to libraries
        yield
