"""A score of episodes that counts failures: the measure where reached, else a stated price.

In: outcomes and a measure of episodes, by method, training seed, scene and episode. Out: scores, of
which smaller ones are better, in arrays of training seeds × episodes.

A mean over the episodes that were reached favours a policy that fails on hard ground. Here such an
episode costs a price, the same for each: a failure early in an episode is not better than one late
in it, and the order of two policies does not depend on which others are compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

PRICE = 2 * math.pi
"""Price of an episode that is not reached [rad]: the pitch variation of one whole turn.

It is a choice, not a measurement. It lies above θ̂_R of each of 2,255 episodes that were reached in
earlier evaluations (at most 4.9 rad by rules and shipped policies, 6.1 rad by ``random``), so that
failing never pays, and not so far above that the score is the success rate in other words: 1 % of
failures weighs as much as 0.06 rad.
"""


@dataclass(frozen=True)
class Method:
    """The episodes of one method: of each training seed, or of a rule, which has one."""

    name: str
    values: Mapping[str, FloatArray]
    """The measure by scene, (S, E) for S training seeds and E episodes, the same for each seed."""
    reached: Mapping[str, NDArray[np.bool_]]
    """Whether the finish was reached, by scene, (S, E)."""
    trained: bool = True
    """Whether its policies were trained; False for rules."""

    @property
    def seeds(self) -> int:
        """Number of training seeds."""
        return len(next(iter(self.values.values())))

    def scores(self, price: float) -> dict[str, FloatArray]:
        """Return the scores by scene, (S, E): the measure, or the price if not reached."""
        return {
            scene: np.where(self.reached[scene], values, price)
            for scene, values in self.values.items()
        }

    def successes(self) -> dict[str, FloatArray]:
        """Return 1 for reached and 0 for other episodes, by scene, (S, E)."""
        return {scene: reached.astype(np.float64) for scene, reached in self.reached.items()}

    def above(self, price: float) -> int:
        """Return the number of reached episodes that cost more than one that is not reached."""
        return sum(
            int(np.sum(self.values[scene][reached] > price))
            for scene, reached in self.reached.items()
        )


def means(scores: Mapping[str, FloatArray]) -> FloatArray:
    """Return the mean score of each training seed on each scene, (S, K)."""
    return np.column_stack([values.mean(axis=1) for values in scores.values()])
