"""Watches whether the belts drive ahead, as they always do in training.

In: speeds of the belts over time. Out: whether the flippers stand by.
"""

from __future__ import annotations

from flipperctl.runtime.limits import Limits

_ROUNDING = 1e-9
"""Time by which a sum of periods may be short [s]."""


class Standby:
    """Finds belts that have been slower than ``limits.standby_speed`` for ``standby_after``.

    It takes what the belts' encoders measure, not how the robot moves: belts that slip under a
    robot that is stuck drive, and belts that were stopped do not.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.reset()

    def reset(self) -> None:
        """Know no speed, as on a robot without encoders of its belts."""
        self._speed: float | None = None
        self._slow_since: float | None = None  # [s]

    def update(self, now: float, speed: float) -> None:
        """Receive a speed of the belts, ahead positive [m/s]; one that is slow counts from now on.

        If the first speed of all is slow, the belts have never driven, and that counts at once.
        """
        first, self._speed = self._speed is None, speed
        if speed >= self._limits.standby_speed:
            self._slow_since = None
        elif self._slow_since is None:
            self._slow_since = now - self._limits.standby_after if first else now

    def due(self, now: float) -> bool:
        """Return whether the flippers stand by; False before any speed."""
        return self._slow_since is not None and now - self._slow_since >= (
            self._limits.standby_after - _ROUNDING
        )

    def reason(self) -> str:
        """Return a sentence with the speed, for an answer in standby."""
        speed = 0.0 if self._speed is None else self._speed
        return (
            f"the belts drive at {speed:.2f} m/s; the flippers are held until that is "
            f"{self._limits.standby_speed:g} m/s or more"
        )
