"""The action table, and the rule by which an action sets the target angles of the flippers.

In: an action; the last targets and the measured angles. Out: steps per joint, or turns [rad]; the
new targets. The environment and a robot that runs an exported policy share these definitions. An
action is an index, or the rates of both pairs. In the square of all rates, the nine indexed actions
are the corners, the middles of the edges and the middle.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, TypeAlias

import numpy as np

from flipperctl.core import FloatArray

ACTIONS: tuple[tuple[int, int], ...] = tuple((i, j) for i, j in product((-1, 0, 1), repeat=2))
"""Action index → (front, rear); +1 raises the flipper pair by one angle step (paper Eq. 3)."""
JOINTS = ("front", "rear")
"""Names of the flipper pairs that an action turns, in the order of ``ACTIONS``."""


Rates: TypeAlias = tuple[float, float]
"""Turns of the front and the rear pair in one decision, each from -1 to 1 [angle steps]."""
Action: TypeAlias = int | Rates
"""An index into ``ACTIONS``, or rates."""
ActionKind: TypeAlias = Literal["turns", "rates"]
"""Whether a policy chooses one of ``ACTIONS``, or rates."""
ALLOWED = (
    f"an integer from 0 to {len(ACTIONS) - 1}, or the rates of the front and the rear pair, each "
    "from -1 to 1, is allowed"
)
_ROUNDING = 1e-6
"""Part of a rate by which it may lie outside [-]."""


def as_action(value: Any) -> Action | None:
    """Return a value as an action, or None if it is not one.

    An index is an integer of Python or numpy, or an integer array without a dimension. Other
    numbers and booleans are none, as for Gymnasium's Discrete. Rates are a pair or an array (2,) of
    finite numbers.
    """
    # In Python a boolean is an integer, too.
    if isinstance(value, bool):
        return None
    try:
        index = operator.index(value)
    except TypeError:
        return _as_rates(value)
    return index if 0 <= index < len(ACTIONS) else None


def _as_rates(value: Any) -> Rates | None:
    if not isinstance(value, tuple | list | np.ndarray):
        return None
    array = np.asarray(value)
    if array.shape != (2,) or array.dtype.kind not in "fiu":
        return None
    front, rear = array.tolist()
    within = abs(front) <= 1 + _ROUNDING and abs(rear) <= 1 + _ROUNDING  # false for NaN
    return (min(1.0, max(-1.0, front)), min(1.0, max(-1.0, rear))) if within else None


def rates_of(outputs: Sequence[float]) -> Rates:
    """Return a network's two outputs as rates, in steps of 0.001.

    The steps are coarser than the rounding by which torch and an exported file differ, so that both
    drive equal episodes.
    """
    front, rear = (round(min(1.0, max(-1.0, output)), 3) for output in outputs)
    return front, rear


def closest(rates: Rates) -> int:
    """Return the index of the action that comes closest to rates."""
    # Halves are rounded up; ``round`` would round them to the even number.
    front, rear = (math.floor(rate + 0.5) for rate in rates)
    return action_index(front, rear)


def turns(step: float, kind: ActionKind = "turns") -> FloatArray:
    """Return the turn of each pair by each action, (9, 2) [rad]; ``step``: one step [rad].

    For rates, each row is the turn by a rate of 1 of a pair, (2, 2), so that rates · turns is the
    turn.
    """
    return np.array(ACTIONS) * step if kind == "turns" else np.eye(len(JOINTS)) * step


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
    action turns it from there. Without that bound, the target would run ahead of a blocked flipper,
    which would jump to it once free.
    """

    window: float
    """Largest distance between the last target and the measured angle [rad]; infinity: no bound."""
    limit: float
    """Largest target, both ways [rad]."""

    def next_targets(
        self, targets: Sequence[float], angles: Sequence[float], turns: Sequence[float]
    ) -> tuple[float, float]:
        """Return the new targets of the front and the rear flippers [rad].

        ``targets``: last targets; ``angles``: measured angles; ``turns``: turns of the action; each
        for the front and the rear flippers in frame R [rad].
        """
        front, rear = map(self._next, targets, angles, turns)
        return front, rear

    def _next(self, target: float, angle: float, turn: float) -> float:
        # The bound comes before the turn, so that a blocked flipper can turn the other way at once.
        near = min(angle + self.window, max(angle - self.window, target))
        return min(self.limit, max(-self.limit, near + turn))
