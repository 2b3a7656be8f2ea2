"""The ground on both sides of a profile, for engines in 3-D."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray


class Surface(ABC):
    """Heights beside the line of a profile, which is the surface's cut at y = 0.

    Frame: world, x forward along the line, y to its left, z up. Heights are read on request;
    engines of the side plane request none.
    """

    @property
    @abstractmethod
    def x(self) -> NDArray[np.float64]:
        """Ascending positions along the line, from the first point to the last, (X,) [m]."""

    @abstractmethod
    def heights(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown.

        Raises:
            ValueError: the ground cannot be read.
        """


class MirroredSurface(Surface):
    """A surface that is driven from its end to its start."""

    def __init__(self, surface: Surface, end: tuple[float, float]) -> None:
        """Reverse ``surface`` about the line's last point, ``end`` (x, z) [m], the new origin."""
        self._surface, self._end = surface, end

    @property
    def x(self) -> NDArray[np.float64]:
        """Positions along the line, ascending, (X,) [m]."""
        return self._end[0] - self._surface.x[::-1]

    def heights(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown."""
        return self._surface.heights(-y[::-1])[::-1, ::-1] - self._end[1]
