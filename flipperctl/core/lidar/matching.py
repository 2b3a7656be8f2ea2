"""Scan matching: the translation between a scan and the scans before it, by small_gicp.

In: level points around the robot and a guess of its position. Out: the corrected position.

Points of a scan are matched to planes through the points of earlier scans (small_gicp's PLANE_ICP),
from the guess by odometry; rotations are left to the inertial unit. Matching point to point would
align the rings of the scans with each other, which move with the robot.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flipperctl.core.arrays import FloatArray

_EVERY = 5
"""Scans from one matched scan to the next; each one earlier matched would add its error [-]."""
_WINDOW = 12
"""Matched scans that later ones are matched to [-]."""
_FAR = 6.0
"""Farthest points that are matched [m]."""
_VOXEL = 0.05
"""Distance of the points of earlier scans after thinning; a new one is twice as thin [m]."""
_GATE = 0.05
"""Share of the information below which a direction is not corrected, and twice which it is wholly:
on level ground no point tells how far the robot has moved [-]."""
_LARGEST = 0.2
"""Largest distance of matched points, and largest correction [m]."""
_FEWEST = 100
"""Points without which a scan is not matched [-]."""


class ScanMatcher:
    """Corrects positions by the matched scans that it remembers."""

    def __init__(self) -> None:
        """Raise ``ImportError`` if small_gicp is not installed."""
        import small_gicp

        self._library = small_gicp
        self._scans: tuple[FloatArray, ...] = ()
        self._count = 0

    def corrected(self, points: FloatArray, guess: FloatArray) -> FloatArray:
        """Return the position, (3,) in frame M [m], from the ``guess`` by odometry.

        ``points`` (P, 3) of the scan are relative to the robot, in the directions of frame M [m].
        """
        self._count += 1
        if (self._count - 1) % _EVERY:
            return guess
        near = points[np.einsum("ij,ij->i", points, points) < _FAR**2]
        if len(near) < _FEWEST:
            return guess
        found = guess + self._correction(near, guess) if self._scans else guess
        thin, _ = self._library.preprocess_points(near, downsampling_resolution=_VOXEL)
        self._scans = (*self._scans, np.asarray(thin.points())[:, :3] + found)[-_WINDOW:]
        return found

    def _correction(self, points: FloatArray, guess: FloatArray) -> FloatArray:
        prepare = self._library.preprocess_points
        source, _ = prepare(points, downsampling_resolution=2 * _VOXEL, num_neighbors=12)
        known = np.concatenate(self._scans)
        target, tree = prepare(known, downsampling_resolution=_VOXEL, num_neighbors=20)
        start = np.eye(4)
        start[:3, 3] = guess
        found = self._library.align(
            target,
            source,
            tree,
            start,
            registration_type="PLANE_ICP",
            max_correspondence_distance=_LARGEST,
            max_iterations=20,
        )
        off = np.asarray(found.T_target_source)[:3, 3] - guess
        if not found.converged or not np.linalg.norm(off) <= _LARGEST:
            return np.zeros(3)
        return gated(off, np.asarray(found.H)[3:, 3:])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later scans do not change."""
        return self._scans, self._count

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._scans, self._count = saved


def gated(correction: FloatArray, information: FloatArray) -> FloatArray:
    """Return the part of a correction (3,) [m] along directions that the points determine.

    ``information``: (3, 3) information matrix of the translation, in any unit.
    """
    held, axes = np.linalg.eigh(information)
    share = held / max(1e-9, float(held.sum()))
    weight = np.clip((share - _GATE) / _GATE, 0.0, 1.0)
    return np.asarray(axes @ (weight * (axes.T @ correction)))
