"""The action table: the steps by which each action turns each joint of the robot.

In: an index. Out: steps per joint, or turns [rad].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from flipperctl.core.arrays import FloatArray


@dataclass(frozen=True)
class ActionTable:
    """The actions of a robot; files store the joints by name, not by order."""

    joints: tuple[str, ...]
    """Names of the J joints that an action turns, in the order of a row."""
    steps: tuple[tuple[int, ...], ...]
    """Turns by each action, (A, J) in multiples of the robot's ``angle_step``; +1 raises [-]."""

    def turns(self, step: float) -> FloatArray:
        """Return the turn of each joint by each action, (A, J) [rad]; ``step``: one step [rad]."""
        return np.array([[count * step for count in row] for row in self.steps])


ACTIONS: tuple[tuple[int, int], ...] = tuple((i, j) for i, j in product((-1, 0, 1), repeat=2))
"""Action index → (front, rear); +1 raises the flipper pair by one angle step (paper Eq. 3)."""
PAIRS = ActionTable(("front", "rear"), ACTIONS)
"""The actions of a robot whose flippers turn in pairs."""


def action_index(front: int, rear: int) -> int:
    """Return the index of the action that turns the pairs by ``front``, ``rear`` in {-1, 0, 1}.

    Raises:
        ValueError: another turn is given.
    """
    for name, turn in (("front", front), ("rear", rear)):
        if turn not in (-1, 0, 1):
            raise ValueError(f"{name} is {turn!r}; -1, 0 or 1 is allowed")
    return 3 * (front + 1) + (rear + 1)
