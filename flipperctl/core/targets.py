"""The action table, and the rule by which an action sets the target angles of the flippers.

In: an index; the last targets and the measured angles. Out: steps per joint, or turns [rad]; the
new targets. The environment and a robot that runs an exported policy share these definitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flipperctl.core import FloatArray

ACTIONS: tuple[tuple[int, int], ...] = tuple((i, j) for i, j in product((-1, 0, 1), repeat=2))
"""Action index → (front, rear); +1 raises the flipper pair by one angle step (paper Eq. 3)."""
JOINTS = ("front", "rear")
"""Names of the flipper pairs that an action turns, in the order of ``ACTIONS``."""


def turns(step: float) -> FloatArray:
    """Return the turn of each pair by each action, (9, 2) [rad]; ``step``: one step [rad]."""
    return np.array(ACTIONS) * step


def action_index(front: int, rear: int) -> int:
    """Return the index of the action that turns the pairs by ``front``, ``rear`` in {-1, 0, 1}.

    Raises:
        ValueError: another turn is given.
    """
    for name, turn in (("front", front), ("rear", rear)):
        if turn not in (-1, 0, 1):
            raise ValueError(f"{name} is {turn!r}; -1, 0 or 1 is allowed")
    return 3 * (front + 1) + (rear + 1)


MEANING = (
    "new target = clip(clip(last target, measured angle - window, measured angle + window) "
    "+ turn of the action, -limit, limit), for each flipper pair; before the first action of an "
    "episode the last target is the measured angle; all angles [rad] in frame R"
)
"""The rule in words, for the metadata of exported policies."""


@dataclass(frozen=True)
class TargetRule:
    """Next flipper targets from the last ones, bounded to ``window`` around the measured angles.

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
