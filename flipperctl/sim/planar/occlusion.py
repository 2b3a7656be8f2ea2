"""The ground that a sensor on a mast has seen since the episode began.

In: the ground, and the robot's state at each scan. Out: the points that have been seen so far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, RobotState

_BEHIND = 10.0
"""Range of the sensor behind the robot [m]; ahead it is the horizon."""


class Mast(NamedTuple):
    """Mount and range of the ranging sensor."""

    mount: tuple[float, float]
    """Position (x, z) of the sensor in frame R [m]."""
    body_length: float
    """Length of the chassis, which hides the ground below it [m]."""
    horizon: float
    """Range ahead of the robot [m]."""


class SeenGround:
    """Remembers which points of the sampled outline a line of sight has reached."""

    def __init__(self, profile: Profile, mast: Mast, density: float, margin: float) -> None:
        """Begin with nothing seen of ``profile`` and ``margin`` [m] of level ground on both sides.

        ``density``: points per metre of its outline [1/m].
        """
        from flipperctl.sim.planar import rays  # numba takes a third of a second to import

        self._rays, self._mast = rays, mast
        self._spacing = 1 / density
        cloud = profile.sample(self._spacing, margin)
        # Edges between two sampled points hide the ground too, so the vertices are added.
        vertices = profile.extended(margin, margin)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices, axis=0).T))])
        at = np.concatenate([np.arange(len(cloud)) * self._spacing, along])  # (M,) [m]
        order = np.argsort(at, kind="stable")
        self._outline = np.concatenate([cloud, vertices])[order]
        self._index = np.where(order < len(cloud), order, -1)
        self._seen = np.zeros(len(cloud), dtype=np.bool_)

    def scan(self, state: RobotState) -> None:
        """Cast rays from the mount and remember the points that they reach."""
        mast = self._mast
        x, z = state.position.tolist()
        self._rays.mark_seen(
            self._outline,
            self._index,
            (x, z, float(state.pitch)),
            mast.mount,
            mast.body_length,
            (x - _BEHIND, x + mast.horizon),
            self._seen,
        )

    def known(self, low: int, high: int) -> NDArray[np.int64]:
        """Return the numbers of the seen points, (K,); see ``rays.known_points``."""
        found: NDArray[np.int64] = self._rays.known_points(self._seen, low, high)
        return found

    def fill(
        self,
        points: FloatArray,
        index: NDArray[np.int64],
        offered: NDArray[np.bool_],
        limits: tuple[float, float],
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the offered points and, where the ground was never seen, filled ones.

        See ``rays.fill_gaps``.
        """
        found: tuple[FloatArray, NDArray[np.bool_]] = self._rays.fill_gaps(
            points, index, offered, self._spacing, limits
        )
        return found

    def save(self) -> NDArray[np.bool_]:
        """Return a snapshot of the seen points."""
        return self._seen.copy()

    def load(self, saved: NDArray[np.bool_]) -> None:
        """Restore a snapshot."""
        self._seen[:] = saved
