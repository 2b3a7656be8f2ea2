"""Free space: where a scan has shown that there is no ground.

In: a scan's points and the LiDAR's position. Out: the height below which the ground must be. A ray
passes nothing until its return, so ground on the way lies below the ray. Points of the map above
it, which mixed returns or a displaced older scan have left, are not ground.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray

_SECTORS = 256
"""Sectors around the LiDAR in which the rays are sorted [-]."""
_BIN = 0.025
"""Length of the parts of a sector [m]."""


class FreeSpace:
    """The lowest ray over each place around a LiDAR."""

    def __init__(self, origin: FloatArray, points: FloatArray, reach: float, margin: float) -> None:
        """Take the rays from ``origin`` (3,) to ``points`` (P, 3) in frame M [m].

        ``reach``: horizontal distance up to which ceilings are wanted [m]. ``margin``: a ray may
        end this much before its return, because that errs [m].
        """
        self._origin = origin
        self._bins = math.ceil(reach / _BIN) + 1
        self._shift = 1 + math.ceil(margin / _BIN)
        away, sector = self._polar(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.where(away > 0, (points[:, 2] - origin[2]) / away, np.inf)
        part = np.minimum((away / _BIN).astype(np.int64), self._bins + self._shift)
        lowest = np.full((_SECTORS, self._bins + self._shift + 1), np.inf)
        np.minimum.at(lowest, (sector, part), slope)
        self._slope = np.minimum.accumulate(lowest[:, ::-1], axis=1)[:, ::-1]

    def ceilings(self, points: FloatArray) -> FloatArray:
        """Return the height of the lowest ray over each of ``points`` (Q, 3), (Q,) [m].

        It is infinite where no ray has passed. Frame M.
        """
        away, sector = self._polar(points)
        part = np.minimum((away / _BIN).astype(np.int64), self._bins - 1) + self._shift
        return np.asarray(self._origin[2] + away * self._slope[sector, part])

    def _polar(self, points: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the horizontal distances (P,) [m] and the sectors (P,) of points (P, 3)."""
        dx, dy = points[:, 0] - self._origin[0], points[:, 1] - self._origin[1]
        turn = np.arctan2(dy, dx) * (_SECTORS / (2 * math.pi))
        return np.hypot(dx, dy), np.floor(turn).astype(np.int64) % _SECTORS
