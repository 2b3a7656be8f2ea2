"""Watches whether the flippers follow their targets.

In: targets and measured angles over time. Out: the names of the pairs that do not follow.
"""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.runtime.limits import Limits

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
