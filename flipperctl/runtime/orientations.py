"""Notices an orientation that no one fills in: level in every message, whatever the robot does.

A ``Quaternion`` of ROS 2 that is left alone is 0 0 0 1, and its covariance 0. In: what an inertial
unit says. Out: whether a level orientation is none.
"""

from __future__ import annotations

import math

_MEMORY = 2.0
"""Time over which rates count; the error of a gyroscope does not add up [s]."""
_TILTED = 0.05
"""Angle that the rates turn, while the orientation stays level, from which it is none [rad]."""
_JUMP, _AT_ONCE = 0.1, 0.05
"""Tilt [rad] from or to which an orientation cannot become level within a time [s]."""
ABSENT = "a filter such as imu_filter_madgwick adds an orientation"


class Levels:
    """Whether exactly level orientations have been found to be none."""

    def __init__(self) -> None:
        self.unset = ""
        """What contradicts them; empty if nothing does."""
        self._turned = [0.0, 0.0]  # about x and y, as far as remembered [rad]
        self._last: tuple[float, float, bool] | None = None  # time, tilt, whether it was level

    def add(self, time: float, tilt: float, rates: tuple[float, float]) -> bool:
        """Learn from a message; return whether its orientation is none.

        ``tilt``: angle of the z axis to the vertical, exactly 0 of an orientation that is not set
        [rad]; ``rates``: about the x and y axes [rad/s].
        """
        level, last = tilt == 0, self._last
        self._last = time, tilt, level
        if last is not None and 0 < (elapsed := time - last[0]) < 1:
            kept = math.exp(-elapsed / _MEMORY) if level and last[2] else 0.0
            turns = [rate * elapsed if math.isfinite(rate) else 0.0 for rate in rates]
            self._turned = [kept * a + b for a, b in zip(self._turned, turns, strict=True)]
            turned = max(map(abs, self._turned))
            if level and last[2] and turned > _TILTED:
                self.unset = f"is level in every message while its rates tilt by {turned:.2f} rad"
            elif level != last[2] and elapsed < _AT_ONCE and abs(tilt - last[1]) > _JUMP:
                self.unset = f"jumps between level and {max(tilt, last[1]):.2f} rad"
        return level and bool(self.unset)
