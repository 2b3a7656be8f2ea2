"""Rows of a replay drawn in proportion to their priority, by a tree of sums.

In: the priority of each row. Out: rows drawn at random, with their probabilities (Schaul et al.
2016, "Prioritized experience replay", proportional variant).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


class Priorities:
    """A binary tree whose leaves are priorities and whose nodes are the sums of their children.

    Each node is computed from its children, never changed by a difference, so that equal
    priorities give equal sums bit for bit, whatever the order in which they came.
    """

    def __init__(self, capacity: int) -> None:
        """Begin with priority 0 for all of ``capacity`` rows."""
        self._leaves = 1 << max(0, capacity - 1).bit_length()
        self._nodes = np.zeros(2 * self._leaves)  # node i has the children 2 i and 2 i + 1

    @property
    def total(self) -> float:
        """Sum of all priorities [-]."""
        return float(self._nodes[1])

    def set(self, rows: Rows, priorities: NDArray[np.floating] | float) -> None:
        """Set the priorities of ``rows``, (R,); of equal rows the last one counts."""
        nodes, at = self._nodes, rows + self._leaves
        nodes[at] = priorities
        while at[0] > 1:
            at = at // 2
            nodes[at] = nodes[2 * at] + nodes[2 * at + 1]

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Rows, NDArray[np.float64]]:
        """Return ``size`` rows with their probabilities, both (size,); one of each equal part."""
        mass = (np.arange(size) + rng.random(size)) * (self.total / size)
        at = np.ones(size, np.int64)
        while at[0] < self._leaves:
            at *= 2
            left = self._nodes[at]
            right = (mass >= left) & (self._nodes[at + 1] > 0)  # rounding never leads to a 0
            mass -= np.where(right, left, 0.0)
            at += right
        return at - self._leaves, self._nodes[at] / self.total
