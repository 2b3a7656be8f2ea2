"""The rule by which an action sets the target angles of the flippers.

In: the last targets, the measured angles and an action's turns. Out: the new targets. The
environment and a robot that runs an exported policy share this definition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MEANING = (
    "new target = clip(clip(last target, measured angle - window, measured angle + window) "
    "+ turn of the action, -limit, limit), for each flipper pair; before the first action of an "
    "episode the last target is the measured angle; all angles [rad] in frame R"
)
"""The rule in words, for the metadata of exported policies."""


@dataclass(frozen=True)
class TargetRule:
    """Computes new targets from the last ones, which it keeps near the measured angles.

    While a flipper follows its targets, they stay on an exact grid of angles, free of measurement
    error. The target of a blocked flipper stays within ``window`` of the measured angle, and an
    action turns it from there; without that bound, the target would run ahead of the flipper,
    which would jump to it once it is free.
    """

    window: float
    """Largest distance between the last target and the measured angle [rad]; infinity: no bound."""
    limit: float
    """Largest target, both ways [rad]."""

    def next_targets(
        self, targets: Sequence[float], angles: Sequence[float], turns: Sequence[float]
    ) -> tuple[float, float]:
        """Return the new targets of the front and the rear flippers [rad].

        ``targets``: last targets; ``angles``: measured angles; ``turns``: turns of the action, a
        row of ``Interface.actions``; each for the front and the rear flippers in frame R [rad].
        """
        front, rear = map(self._next, targets, angles, turns)
        return front, rear

    def _next(self, target: float, angle: float, turn: float) -> float:
        near = min(angle + self.window, max(angle - self.window, target))
        return min(self.limit, max(-self.limit, near + turn))
