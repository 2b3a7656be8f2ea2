"""Labels: a teacher's target distributions over actions for its student.

In: the cost of each action, or the action that a policy takes. Out: probabilities, (9,).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, CostPolicy, FloatArray, Perception, Policy

TEMPERATURE = 0.3
"""Default cost difference that makes an action e times less probable [s]."""


def from_costs(costs: FloatArray, temperature: float = TEMPERATURE) -> NDArray[np.float32]:
    """Return softmax(-costs / temperature), (9,).

    ``costs``: finite cost of each action, (9,) [s]; ``temperature`` in seconds.
    """
    weights = np.exp((costs.min() - costs) / temperature)
    return np.asarray(weights / weights.sum(), np.float32)


def from_action(action: int) -> NDArray[np.float32]:
    """Return the distribution that is 1 at ``action`` and 0 elsewhere, (9,)."""
    label = np.zeros(len(ACTIONS), np.float32)
    label[action] = 1.0
    return label


def none() -> NDArray[np.float32]:
    """Return the zeros of a state without a label, (9,)."""
    return np.zeros(len(ACTIONS), np.float32)


class Labeller:
    """Asks a policy for actions and labels them, by their costs if the policy offers them."""

    def __init__(self, policy: Policy, temperature: float = TEMPERATURE) -> None:
        """``temperature``: difference of costs [s]; see ``from_costs``."""
        self._policy, self._temperature = policy, temperature
        # Checked once: a check against a protocol takes longer than parts of a decision.
        self._costs = policy if isinstance(policy, CostPolicy) else None

    def choose(self, p: Perception) -> tuple[int, NDArray[np.float32]]:
        """Return the policy's action, the cheapest if it offers costs, and the label, (9,)."""
        if self._costs is None:
            action = self._policy.act(p)
            return action, from_action(action)
        costs = self._costs.costs(p)
        return int(costs.argmin()), from_costs(costs, self._temperature)

    def took(self, action: int) -> None:
        """Tell a policy that offers costs which action was taken after ``choose``."""
        if self._costs is not None:
            self._costs.took(action)
