"""Groups of states with the values of their actions, which a teacher gives to a student."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StateGroups:
    """G groups of K states that lie close to each other on one ground."""

    observations: NDArray[np.float32]
    """(G, K, N + 3) in SI units."""
    values: NDArray[np.float32]
    """Discounted return from each action on, (G, K, 9) [-]; every value is finite."""
