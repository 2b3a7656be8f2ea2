"""The recorded ground beside a line, read on first use.

In: a function that reads heights. Out: a ``Surface`` that remembers the heights it read last.
"""

from collections.abc import Callable

import numpy as np

from flipperctl.api import FloatArray, Surface


class RecordedSurface(Surface):
    """Heights from a file, read once, since each episode asks for the same ones."""

    def __init__(self, x: FloatArray, read: Callable[[FloatArray], FloatArray]) -> None:
        """Read heights (X, Y) at ``x`` (X,) and the asked y (Y,) by ``read`` [m]."""
        self._x, self._read = x, read
        self._last: tuple[FloatArray, FloatArray] | None = None

    @property
    def x(self) -> FloatArray:
        """Places along the line, ascending, (X,) [m]."""
        return self._x

    def heights(self, y: FloatArray) -> FloatArray:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown."""
        if self._last is None or not np.array_equal(self._last[0], y):
            self._last = y.copy(), self._read(y)
        return self._last[1]
