"""Labels: the distributions over actions that a teacher wants its student to have.

In: the cost of each action, or the action that a controller takes. Out: probabilities, (9,).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, FloatArray

TEMPERATURE = 0.3
"""Default difference of costs by which an action becomes e times less probable [s]."""


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
