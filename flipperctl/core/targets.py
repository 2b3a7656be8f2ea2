"""The action table, and the rule by which an action sets the target angles of the flippers.

In: an action; the last targets and the measured angles. Out: steps per joint, or turns [rad]; the
new targets. The environment and a robot that runs an exported policy share these definitions. An
action is an index, or the rates of all joints. In the cube of all rates, the indexed actions are
the corners, the middles of edges and faces, and the middle.

The flippers turn in pairs, or all four alone. The joints at the front come first, left before
right; J is their number.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from flipperctl.core import FloatArray

T = TypeVar("T")
Flippers: TypeAlias = Literal["pairs", "four"]
"""Whether the left and the right flippers turn together, or each of the four alone."""
JOINTS: Mapping[Flippers, tuple[str, ...]] = {
    "pairs": ("front", "rear"),
    "four": ("front_left", "front_right", "rear_left", "rear_right"),
}
"""Names of the joints that an action turns, in the order of ``actions_of``."""


@cache
def actions_of(joints: int) -> tuple[tuple[int, ...], ...]:
    """Return the turns of all J joints by each action, (3^J, J); +1 raises (paper Eq. 3)."""
    return tuple(product((-1, 0, 1), repeat=joints))


ACTIONS: tuple[tuple[int, int], ...] = tuple((i, j) for i, j in actions_of(2))
"""Action index → (front, rear) of the pairs; +1 raises one by one angle step (paper Eq. 3)."""
Rates: TypeAlias = tuple[float, ...]
"""Turn of each joint in one decision, from -1 to 1 [angle steps]."""
Action: TypeAlias = int | Rates
"""An index into ``actions_of``, which for pairs is ``ACTIONS``, or rates."""
ActionKind: TypeAlias = Literal["turns", "rates"]
"""Whether a policy chooses an indexed action, or rates."""


def allowed(joints: int = 2) -> str:
    """Return in words which actions J joints have, for errors."""
    of = {2: "the front and the rear pair", 4: "the four flippers"}[joints]
    return (
        f"an integer from 0 to {3**joints - 1}, or the rates of {of}, each from -1 to 1, is allowed"
    )


_ROUNDING = 1e-6
"""Part of a rate by which it may lie outside [-]."""


def as_action(value: Any, joints: int = 2) -> Action | None:
    """Return a value as an action of J joints, or None if it is not one.

    An index is an integer of Python or numpy, or an integer array without a dimension. Other
    numbers and booleans are none, as for Gymnasium's Discrete. Rates are a tuple, a list or an
    array (J,) of finite numbers.
    """
    # In Python a boolean is an integer, too.
    if isinstance(value, bool):
        return None
    try:
        index = operator.index(value)
    except TypeError:
        return _as_rates(value, joints)
    return index if 0 <= index < 3**joints else None


def _as_rates(value: Any, joints: int) -> Rates | None:
    if not isinstance(value, tuple | list | np.ndarray):
        return None
    array = np.asarray(value)
    if array.shape != (joints,) or array.dtype.kind not in "fiu":
        return None
    rates = array.tolist()
    within = all(abs(rate) <= 1 + _ROUNDING for rate in rates)  # false for NaN
    return tuple(min(1.0, max(-1.0, rate)) for rate in rates) if within else None


def rates_of(outputs: Sequence[float]) -> Rates:
    """Return a network's outputs as rates, in steps of 0.001.

    The steps are coarser than the rounding by which torch and an exported file differ, so that both
    drive equal episodes.
    """
    return tuple(round(min(1.0, max(-1.0, output)), 3) for output in outputs)


def closest(action: Action) -> int:
    """Return the index of the action that comes closest to rates; an index is its own."""
    if not isinstance(action, tuple):
        return action
    # Halves are rounded up; ``round`` would round them to the even number.
    return action_index(*(math.floor(rate + 0.5) for rate in action))


def turns(step: float, kind: ActionKind = "turns", joints: int = 2) -> FloatArray:
    """Return the turn of each joint by each action, (3^J, J) [rad]; ``step``: one step [rad].

    For rates, each row is the turn by a rate of 1 of a joint, (J, J), so that rates · turns is the
    turn.
    """
    return np.array(actions_of(joints)) * step if kind == "turns" else np.eye(joints) * step


def action_index(*turns: int) -> int:
    """Return the index of the action that turns each joint by -1, 0 or 1; of pairs, front and rear.

    Raises:
        ValueError: another turn is given.
    """
    index = 0
    for name, turn in zip(JOINTS["pairs" if len(turns) == 2 else "four"], turns, strict=True):
        if turn not in (-1, 0, 1):
            raise ValueError(f"{name} is {turn!r}; -1, 0 or 1 is allowed")
        index = 3 * index + turn + 1
    return index


def alike(pairs: Sequence[T], joints: int) -> tuple[T, ...]:
    """Return what the front and the rear pair have for each of J joints, both sides alike."""
    return tuple(value for value in pairs for _ in range(joints // 2))


def of_pairs(action: Action, joints: int) -> Action:
    """Return an action of the pairs as one of J joints, both sides alike; J rates are their own."""
    if isinstance(action, tuple):
        return action if len(action) == joints else alike(action, joints)
    return action_index(*alike(ACTIONS[action], joints))


def of_rule(action: int, joints: int) -> Action:
    """Return an index of J joints as rules give it: of pairs an index, of others J rates."""
    return action if joints == 2 else tuple(map(float, actions_of(joints)[action]))


def to_pairs(action: int, joints: int) -> int:
    """Return the index of the pairs that comes closest to an index of J joints."""
    return closest(means(actions_of(joints)[action]))


def means(joints: Sequence[float]) -> tuple[float, float]:
    """Return the means of the joints at the front and at the rear."""
    half = len(joints) // 2
    return sum(joints[:half]) / half, sum(joints[half:]) / half


def turned(transition: Any) -> tuple[Any, Any]:
    """Return the absolute turns at the front and at the rear, the means of both sides [rad]."""
    ends = zip(angles_of(transition.before), angles_of(transition.after), strict=True)
    return means([abs(after - before) for before, after in ends])


def by_joint(angles: Sequence[float]) -> dict[str, Any]:
    """Return angles of joints, (J,), as fields of a state: ``front``, ``rear`` and ``flippers``."""
    front, rear = means(angles)
    return {"front": front, "rear": rear, "flippers": tuple(angles) if len(angles) > 2 else ()}


def angles_of(posture: Any) -> tuple[float, ...]:
    """Return the angles of all joints of a state or a perception, (J,) [rad]; see ``by_joint``."""
    angles: tuple[float, ...] = posture.flippers or (posture.front, posture.rear)
    return angles


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
    ) -> tuple[float, ...]:
        """Return the new target of each joint, (J,) [rad].

        ``targets``: last targets; ``angles``: measured angles; ``turns``: turns of the action; each
        (J,) in frame R [rad].
        """
        return tuple(map(self._next, targets, angles, turns))

    def _next(self, target: float, angle: float, turn: float) -> float:
        # The bound comes before the turn, so that a blocked flipper can turn the other way at once.
        near = min(angle + self.window, max(angle - self.window, target))
        return min(self.limit, max(-self.limit, near + turn))
