"""How far the odometry of an estimator drifts from the poses that a bag holds.

In: pairs of poses of one instant. Out: the difference of both ways since their starts.
"""

from __future__ import annotations

import math

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.core.lidar.messages import Pose


class Drift:
    """Compares two ways, each relative to its own start."""

    def __init__(self) -> None:
        self._starts: tuple[Pose, Pose] | None = None
        self._last: FloatArray | None = None
        self._way = 0.0
        self._errors: list[FloatArray] = []

    def add(self, estimated: Pose, recorded: Pose) -> None:
        """Add the poses of one instant."""
        if self._starts is None:
            self._starts = estimated, recorded
        ours, theirs = (
            _since(start, pose)
            for start, pose in zip(self._starts, (estimated, recorded), strict=True)
        )
        if self._last is not None:
            self._way += float(np.linalg.norm(theirs[:3] - self._last[:3]))
        self._last = theirs
        self._errors.append(ours - theirs)

    def summary(self) -> dict[str, float | None] | None:
        """Return the way and the errors at its end; None without poses to compare.

        ``horizontal`` and ``height`` are in [m], ``share`` is the first per way [-], and
        ``heading`` is in [rad].
        """
        if not self._errors:
            return None
        x, y, z, turn = self._errors[-1].tolist()
        horizontal = math.hypot(x, y)
        return {
            "way": self._way,
            "horizontal": horizontal,
            "share": horizontal / self._way if self._way > 0.1 else None,
            "height": z,
            "heading": math.remainder(turn, 2 * math.pi),
        }


def _since(start: Pose, pose: Pose) -> FloatArray:
    """Return the motion since the start in its heading: x, y and z [m], and the turn [rad]."""
    cos, sin = math.cos(start.yaw), math.sin(start.yaw)
    x, y = pose.x - start.x, pose.y - start.y
    return np.array([cos * x + sin * y, cos * y - sin * x, pose.z - start.z, pose.yaw - start.yaw])
