"""What a robot would perceive at many predicted places of one ground.

In: a polyline of the ground, places and states. Out: observations, as without sensing errors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, ObservationLayout
from flipperctl.lookahead.model import FLIPPERS

_SPACING = 0.02
"""Distance between two points of the ground's outline [m]."""


class Ground:
    """Points along a polyline, vertical faces included, and level ground beyond its ends."""

    def __init__(self, line: FloatArray, layout: ObservationLayout) -> None:
        """``line``: (V, 2) [m], x never decreasing, not empty."""
        length = np.hypot(*np.diff(line, axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(length)])
        at = np.arange(0.0, along[-1] + _SPACING / 2, _SPACING)
        self._x = np.interp(at, along, line[:, 0])
        self._sums = np.concatenate([[0.0], np.cumsum(np.interp(at, along, line[:, 1]))])
        self._line = line
        self._edges = np.arange(layout.bins + 1) * layout.bin_width - layout.reach

    def observations(self, places: FloatArray, states: FloatArray) -> NDArray[np.float32]:
        """Return the observations at ``places`` (M, 2) in ``states`` (M, ``STATE``), (M, N + 3).

        The height of a bin is the mean of its points; a bin without points has the height of the
        line in its middle.
        """
        edges = places[:, :1] + self._edges  # (M, N + 1)
        index = np.searchsorted(self._x, edges)
        count = np.diff(index, axis=1)
        total = self._sums[index[:, 1:]] - self._sums[index[:, :-1]]
        heights = total / np.maximum(count, 1)
        if not count.all():
            middle = (edges[:, 1:] + edges[:, :-1]) / 2
            level = np.interp(middle, self._line[:, 0], self._line[:, 1])
            heights = np.where(count == 0, level, heights)
        angles = states[:, [FLIPPERS, FLIPPERS + 1, 2]]
        return np.column_stack([heights - places[:, 1:], angles]).astype(np.float32)
