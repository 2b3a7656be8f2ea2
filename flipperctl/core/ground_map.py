"""A map of the ground around the robot, built from its latest scans.

In: sensed points in frame L and the expected motion of the robot. Out: its estimated motion, and a
polyline of the ground in frame L, thinned to what a rolling track can feel. Without noise the
latest scan is the ground; with noise the scans of the last decisions are aligned and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray


def kept_points(
    points: FloatArray, fixed: NDArray[np.bool_], tolerance: float, span: float
) -> NDArray[np.bool_]:
    """Return which of the (V, 2) points [m] to keep, (V,); ``fixed`` points are always kept.

    The next kept point is the farthest to which a straight line may replace the points between.
    They must lie within ``tolerance`` [m] of the line (the cone test of Imai and Iri 1988), or all
    lie below a line of at most ``span`` [m].
    """
    count = len(points)
    keep = np.zeros(count, dtype=np.bool_)
    keep[0] = True
    start = 0
    while start < count - 1:
        best = start + 1
        low, high, longest = -math.inf, math.inf, 0.0  # directions of lines within the tolerance
        steepest, height = -math.inf, 0.0  # direction and distance of the upper hull's last point
        for j in range(start + 1, count):
            dx, dz = points[j, 0] - points[start, 0], points[j, 1] - points[start, 1]
            distance, direction = math.hypot(dx, dz), math.atan2(dz, dx)
            # Cone test: the line to this point passes all points before it within the tolerance.
            if low <= direction <= high and distance >= longest:
                best = j
            # No point before this one lies above the line to it, which bridges a hollow.
            if direction > steepest or (direction == steepest and distance >= height):
                steepest, height = direction, distance
                if distance <= span:
                    best = j
            if fixed[j]:
                break
            # Each point narrows the cone of directions that pass it closely enough.
            if distance > tolerance:
                half = math.asin(tolerance / distance)
                low, high = max(low, direction - half), min(high, direction + half)
            longest = max(longest, distance)
            # Neither test can succeed any farther on.
            if low > high and dx > span:
                break
        start = best
        keep[start] = True
    return keep


_SEARCH = np.arange(-0.10, 0.101, 0.01)
"""Corrections of the guessed distance that the alignment tries [m]."""
_OUTLIER = 0.05
"""Largest residual of a point that the alignment counts; larger ones are clipped to it [m]."""
_PRIOR = 0.02
"""Penalty on corrections of the guess, as residual per metre; it decides on level ground [-]."""
_EXACT = 0.002  # noise below which the latest scan alone is the ground [m]
_CELL = 0.03  # length of the cells in which noisy points are averaged [m]
_TOLERANCE = 0.002  # thinning of the ground without noise [m]
_FEWEST = 8  # points of a scan below which it tells neither the motion nor the noise [-]
_NARROW = 0.05
"""Hollows narrower than this are bridged, since the tracks sink into them by 3 mm at most [m]."""

Thinning = Callable[[FloatArray, NDArray[np.bool_], float, float], NDArray[np.bool_]]
"""A function with the signature of ``kept_points``."""


class GroundMap:
    """Stores aligned scans, all in the current frame L."""

    def __init__(self, memory: int, kept_points: Thinning = kept_points) -> None:
        """Store the last ``memory`` scans.

        ``kept_points``: the function that thins the ground, such as a compiled one.
        """
        self._memory, self._kept_points = memory, kept_points
        self._scans: list[FloatArray] = []
        self.noise = 0.0
        """Estimated standard deviation of the height of the latest scan's points [m]."""

    def add(self, points: FloatArray, guess: tuple[float, float]) -> tuple[float, float]:
        """Add a scan, (P, 2) in frame L [m]; return the motion (x, z) since the previous one [m].

        ``guess`` is the expected motion, which is returned if the scans cannot be aligned. A scan
        of fewer than 8 points counts only while there is no longer one.
        """
        if len(points) < _FEWEST:
            self._move(guess)
            if len(points) and all(len(scan) < _FEWEST for scan in self._scans):
                self._scans = [*self._scans, points][-self._memory :]
            return guess
        self.noise = _noise(points)
        motion = self._align(points, guess) if self._scans else guess
        self._move(motion)
        self._scans = [*self._scans, points][-self._memory :]
        return motion

    def line(self) -> FloatArray:
        """Return the ground as a polyline in frame L, x never decreasing, (V, 2) [m]."""
        if not self._scans:
            return np.zeros((0, 2))
        # Without noise the latest scan is exact, and averages would only round off its edges.
        if self.noise < _EXACT or (len(self._scans) == 1 and self.noise < 2 * _EXACT):
            points, tolerance = self._scans[-1], _TOLERANCE
        else:
            points = _averaged(np.concatenate(self._scans), self.noise)
            tolerance = _TOLERANCE + 0.3 * self.noise
        keep = self._kept_points(points, np.zeros(len(points), np.bool_), tolerance, _NARROW)
        return np.asarray(points[keep])

    def _move(self, motion: tuple[float, float]) -> None:
        self._scans = [scan - motion for scan in self._scans]

    def _align(self, points: FloatArray, guess: tuple[float, float]) -> tuple[float, float]:
        """Return the motion that best aligns the scan with the map."""
        known = (
            self._scans[-1]
            if self.noise < _EXACT
            else _averaged(np.concatenate(self._scans), self.noise)
        )
        x, z = points.T
        best = (np.inf, *guess)
        # The median of the residuals aligns z for each correction along x, whatever edges do.
        for correction in _SEARCH:
            dx = guess[0] + correction
            at = x + dx  # x of the points in the map's frame [m]
            inside = (at >= known[0, 0]) & (at <= known[-1, 0])
            if np.count_nonzero(inside) < _FEWEST:
                continue
            residual = np.interp(at[inside], known[:, 0], known[:, 1]) - z[inside]
            dz = float(np.median(residual))
            cost = np.minimum(np.abs(residual - dz), _OUTLIER).mean() + _PRIOR * abs(correction)
            if cost < best[0]:
                best = (cost, dx, dz)
        return best[1], best[2]


def _noise(points: FloatArray) -> float:
    """Return the standard deviation of the heights about a locally straight line [m].

    It is estimated from the median of the second differences, which edges do not affect.
    """
    second = np.diff(points[:, 1], 2)
    return float(1.4826 * np.median(np.abs(second)) / np.sqrt(6))


def _averaged(points: FloatArray, noise: float) -> FloatArray:
    """Return the median of each cell, or the lower and upper end of a face within it."""
    order = np.argsort(points[:, 0], kind="stable")
    x, z = points[order].T
    cell = np.floor(x / _CELL).astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(cell) > 0]))
    groups = list(zip(np.split(x, starts[1:]), np.split(z, starts[1:]), strict=True))
    middle = np.array([np.median(heights) for _, heights in groups])
    line: list[tuple[float, float]] = []
    # Where heights spread by more than noise and slope explain, a face stands, whose ends both
    # count.
    for i, (at, heights) in enumerate(groups):
        where = float(at.mean())
        low, high = np.quantile(heights, (0.15, 0.85))
        if high - low > 4 * noise + _CELL:
            rising = middle[min(i + 1, len(middle) - 1)] >= middle[max(i - 1, 0)]
            ends = (low, high) if rising else (high, low)
            line += [(where, float(end)) for end in ends]
        else:
            line.append((where, float(middle[i])))
    return np.array(line)
