"""Watches whether the flippers follow their targets, and whether the belts drive ahead.

In: targets, measured angles and speeds of the belts over time. Out: the names of the pairs that do
not follow; whether the flippers stand by, since the belts always drive ahead in training.
"""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.runtime.setup import Limits

PAIRS = ("front", "rear")
_APPROACH = 0.02
"""Reduction of the error that counts as an approach [rad]."""


@dataclass
class _Pair:
    error: float = 0.0
    """Smallest error since the last approach [rad]."""
    since: float = 0.0
    """Time of the last approach [s]."""


class Following:
    """Finds flippers that miss their targets and come no closer for ``limits.stall_time``."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._pairs = {name: _Pair() for name in PAIRS}
        self._began = False

    def reset(self) -> None:
        """Forget the past."""
        self._began = False

    def stalled(
        self, now: float, targets: tuple[float, float], angles: tuple[float, float]
    ) -> tuple[str, ...]:
        """Return the pairs that have not approached their targets for too long; all in [rad]."""
        found = []
        for name, target, angle in zip(PAIRS, targets, angles, strict=True):
            pair, error = self._pairs[name], abs(target - angle)
            near = error <= self._limits.stall_error
            if not self._began or near or error < pair.error - _APPROACH:
                pair.error, pair.since = error, now
            elif error > pair.error + self._limits.stall_error:  # another target was set
                pair.error = error
            if now - pair.since >= self._limits.stall_time:
                found.append(name)
        self._began = True
        return tuple(found)


_ROUNDING = 1e-9
"""Time by which a sum of periods may be short [s]."""


class Standby:
    """Finds belts that have been slower than ``limits.standby_speed`` for ``standby_after``.

    Once they have, it takes ``standby_until`` of a larger speed to end that: a single one, as from
    slack tracks or a coarse encoder, moves no flipper of a parked robot. It takes what the belts'
    encoders measure, not how the robot moves: belts that slip under a robot that is stuck drive,
    and belts that were stopped do not.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.reset()

    def reset(self) -> None:
        """Know no speed, as on a robot without encoders of its belts."""
        self._speed: float | None = None
        self._driven, self._since = True, 0.0  # what the last speed says, and since when [s]
        self._stands = False

    def update(self, now: float, speed: float) -> None:
        """Receive a speed of the belts, ahead positive [m/s].

        If the first speed of all is slow, the belts have never driven, and that counts at once.
        """
        first, self._speed = self._speed is None, speed
        driven = speed >= self._limits.standby_speed
        if first:
            self._stands = not driven
        if driven is not self._driven:
            self._driven, self._since = driven, now

    def stands(self, now: float) -> bool:
        """Return whether the flippers stand by; False before any speed."""
        if self._stands is self._driven:  # the last speeds say otherwise
            wait = self._limits.standby_until if self._driven else self._limits.standby_after
            if now - self._since >= wait - _ROUNDING:
                self._stands = not self._driven
        return self._stands

    def reason(self) -> str:
        """Return a sentence with the speed, for an answer in standby."""
        speed = 0.0 if self._speed is None else self._speed
        return (
            f"the belts drive at {speed:.2f} m/s; the flippers are held until that is "
            f"{self._limits.standby_speed:g} m/s or more"
        )
