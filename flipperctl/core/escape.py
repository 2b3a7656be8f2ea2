"""How a policy that warns of its own failure gets away: it draws its actions for a few decisions.

In: the Q-values of a decision, and whether the policy warns. Out: the action. Simulator and robot
share this definition.

A deterministic policy that is stuck repeats what it did. Drawn actions end the repetition, and are
likely to be good ones, since the probabilities follow the Q-values.

It presumes that the belts drive, as in training: a parked robot repeats its observations, too.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

MEANING = (
    "on a warning, the action of this decision and the next ones, decisions in all, is drawn with "
    "the probabilities softmax(q_values / temperature) in place of the largest q_value"
)
"""The rule in words, for the metadata of exported policies."""


def drawn(weights: Sequence[float], uniform: float) -> int:
    """Return the index that a number from [0, 1) draws with probabilities as the weights."""
    totals = list(accumulate(weights))
    return bisect(totals, uniform * totals[-1])


@dataclass(frozen=True)
class EscapeRule:
    """When and how actions are drawn."""

    temperature: float
    """Difference of Q-values by which an action becomes e times less probable, above 0 [-]."""
    decisions: int
    """Decisions from a warning on whose actions are drawn, at least 1 [-]."""


class Escape:
    """The draws of one episode; equal episodes have equal ones."""

    def __init__(self, rule: EscapeRule) -> None:
        self._rule = rule
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._rng, self._left = np.random.default_rng(0), 0

    def due(self, *, warns: bool) -> bool:
        """Return whether the action of the next decision is drawn; call it once a decision.

        ``warns``: whether the policy warns at this decision.
        """
        self._left = self._rule.decisions if warns else max(0, self._left - 1)
        return self._left > 0

    def draw(self, values: Sequence[float]) -> int:
        """Return the index of an action drawn by its finite Q-values, (9,)."""
        largest, scale = max(values), 1 / self._rule.temperature
        # Nine numbers: sums in Python take a third of the time of numpy's.
        return drawn([math.exp((v - largest) * scale) for v in values], self._rng.random())
