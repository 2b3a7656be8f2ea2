"""Methods over their training seeds: scores that count failures, success and its differences.

In: outcomes and a measure of episodes, by method, training seed, scene and episode. Out: scores, of
which smaller ones are better, in arrays of training seeds × episodes, and rates with intervals.

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
from flipperctl.evaluation.seeds import difference_interval, mean_interval
from flipperctl.evaluation.statistics import (
    Interval,
    PairedSuccess,
    mcnemar_p,
    mean_of,
    paired_success,
    proportion,
)

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


def success_interval(method: Method) -> Interval:
    """Return the success rate.

    Where nothing varies in any scene, the interval is that of one seed, whose episodes all have.
    """
    rates = method.successes()
    episodes = sum(values.shape[1] for values in rates.values())
    mean = float(np.mean([values.mean() for values in rates.values()]))
    if mean in (0.0, 1.0) or (method.seeds == 1 and len(rates) == 1):
        return proportion(round(mean * episodes), episodes)
    found = mean_interval(rates)
    if found.low is None or found.high is None:
        return found
    if found.low == found.high:
        counts = [(round(float(v.mean()) * v.shape[1]), v.shape[1]) for v in rates.values()]
        return mean_of([proportion(reached, total) for reached, total in counts])
    return within(found, 0.0, 1.0)


def within(found: Interval, least: float, most: float) -> Interval:
    """Return an interval of what lies between two numbers.

    Values that do not vary, such as the price of failures alone, have none: they do not tell how
    others would.
    """
    if found.low is None or found.high is None or found.low == found.high:
        return Interval(found.mean, None, None)
    return Interval(found.mean, max(least, found.low), min(most, found.high))


def success_difference(ours: Method, theirs: Method) -> tuple[Interval | PairedSuccess, float]:
    """Return our success minus theirs over seeds and episodes with its interval, and its p-value.

    If the interval has no width (all seeds agree), that of one seed's episodes is taken: the score
    interval of each scene and McNemar's exact test; no interval if the seeds' episodes differ.
    """
    if len(ours.reached) == 1 and _agree(ours) and _agree(theirs):
        (mine,), (other,) = ours.reached.values(), theirs.reached.values()
        paired = _pair(mine[0], other[0])
        return paired, paired.p
    found, p = difference_interval(ours.successes(), theirs.successes())
    if found.low is None or found.high is None:
        return found, p
    if found.low < found.high:
        return Interval(found.mean, max(-1.0, found.low), min(1.0, found.high)), p
    if not (_agree(ours) and _agree(theirs)):
        return Interval(found.mean, None, None), 1.0
    pairs = [
        _pair(values[0], others[0])
        for values, others in zip(ours.reached.values(), theirs.reached.values(), strict=True)
    ]
    won, lost = (sum(getattr(pair, name) for pair in pairs) for name in ("won", "lost"))
    return mean_of(pairs), mcnemar_p(won, lost)


def _agree(method: Method) -> bool:
    """Return whether all seeds reach the finish in the same episodes; a single one does."""
    return all((values == values[0]).all() for values in method.reached.values())


def _pair(ours: NDArray[np.bool_], theirs: NDArray[np.bool_]) -> PairedSuccess:
    return paired_success(int(np.sum(ours & ~theirs)), int(np.sum(theirs & ~ours)), len(ours))
