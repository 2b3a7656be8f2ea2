"""95 % intervals and exact tests: means, rates, paired differences, many comparisons.

In: numbers or counts. Out: an ``Interval`` or a p-value. ``benchmarks/coverage.py`` simulates how
often the intervals contain the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Interval:
    """A mean or a rate and its 95 % interval, in the unit of the values."""

    mean: float
    low: float | None
    """Lower end; None, like ``high``, if there are too few values for an interval."""
    high: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name."""
        return asdict(self)

    @property
    def distances(self) -> tuple[float, float]:
        """Distances of the mean to both ends; 0 without an interval."""
        low, high = (self.mean if end is None else end for end in (self.low, self.high))
        return self.mean - low, high - self.mean

    def scaled(self, factor: float) -> Interval:
        """Return the interval in another unit, of which ``factor``, at least 0, make one."""
        ends = (None if end is None else factor * end for end in (self.low, self.high))
        return Interval(factor * self.mean, *ends)


@dataclass(frozen=True)
class PairedSuccess(Interval):
    """The difference of two success rates over equal seeds, a policy's minus its baseline's."""

    episodes: int
    """Number of seeds."""
    won: int
    """Number of seeds with which only the policy reached the finish."""
    lost: int
    """Number of seeds with which only the baseline reached the finish."""
    p: float
    """Two-sided p-value of McNemar's exact test [-]."""
    p_holm: float
    """The same, corrected for all such comparisons that are shown together (Holm) [-]."""


FEWEST = 5  # smallest number of values whose mean has an interval [-]
Z = 1.959963984540054  # 97.5 % quantile of the standard normal distribution [-]
_HALVINGS = 60
"""Halvings of an interval of length 1 after which its ends are equal in double precision [-]."""


def interval(values: Sequence[float]) -> Interval:
    """Return the mean of (K,) values with the 95 % interval of Student's t (Student 1908).

    It is exact for normal data; ``benchmarks/coverage.py`` estimates it for others. Fewer than
    ``FEWEST`` values have no interval: its ends are None.
    """
    if len(values) == 0:
        raise ValueError("an interval needs at least one value")
    array = np.asarray(values, dtype=np.float64)
    mean, count = float(array.mean()), len(array)
    if count < FEWEST:
        return Interval(mean, None, None)
    from scipy.special import stdtrit

    # Student's t, since the deviation is estimated from the same values
    half = float(stdtrit(count - 1, 0.975) * array.std(ddof=1) / math.sqrt(count))
    return Interval(mean, mean - half, mean + half)


def mean_p(values: Sequence[float]) -> float:
    """Return the two-sided p-value for a mean of 0 (Student's t); 1 below ``FEWEST`` values."""
    array = np.asarray(values, dtype=np.float64)
    if len(array) < FEWEST or not array.any():
        return 1.0
    deviation = float(array.std(ddof=1))
    if deviation == 0:
        return 0.0
    from scipy.special import stdtr

    ratio = abs(float(array.mean())) / deviation * math.sqrt(len(array))
    return 2 * float(stdtr(len(array) - 1, -ratio))


def proportion(count: float, total: int) -> Interval:
    """Return the rate ``count / total`` with its 95 % score interval (Wilson 1927).

    It exists for any number of outcomes: five of five give a lower end of 0.566.
    """
    if total == 0:
        raise ValueError("a rate needs at least one outcome")
    rate, spread = count / total, Z**2 / total
    centre = (rate + spread / 2) / (1 + spread)
    half = Z * math.sqrt(rate * (1 - rate) / total + spread / (4 * total)) / (1 + spread)
    # Set 0 and 1 exactly, since rounding errors could exceed them.
    low = centre - half if count > 0 else 0.0
    high = centre + half if count < total else 1.0
    return Interval(rate, low, high)


def mean_of(parts: Sequence[Interval]) -> Interval:
    """Return the mean of independent estimates with the interval that theirs imply.

    The distances of their ends add up as squares (Zou & Donner 2008), so that rates of 0 and 1, in
    which nothing varies, leave a width. Every part has both ends.
    """
    # Distances to the ends add as squares, below and above apart.
    mean = float(np.mean([part.mean for part in parts]))
    below, above = np.linalg.norm([part.distances for part in parts], axis=0).tolist()
    return Interval(mean, mean - below / len(parts), mean + above / len(parts))


def paired_success(won: int, lost: int, total: int) -> PairedSuccess:
    """Return the success rate of a policy minus another policy's, over ``total`` equal seeds.

    ``won`` and ``lost``: numbers of seeds with which only the policy or only the other succeeded.
    The 95 % interval is the score interval for paired proportions (Tango 1998). Its width is
    positive even if both are 0: [-0.434, 0.434] for five seeds. ``p`` is McNemar's exact test: the
    probability, if both are equally good, that the seeds with which only one succeeded are split at
    least as unevenly. ``views.summary.correct`` corrects ``p_holm``.
    """
    if total == 0:
        raise ValueError("a difference needs at least one pair")
    p = mcnemar_p(won, lost)
    low = _difference_with_score(won, lost, total, Z) if lost < total else -1.0
    high = _difference_with_score(won, lost, total, -Z) if won < total else 1.0
    return PairedSuccess((won - lost) / total, low, high, total, won, lost, p, p_holm=p)


def mcnemar_p(won: int, lost: int) -> float:
    """Return the two-sided p-value of McNemar's exact test from the counts of paired_success."""
    if won == lost:
        return 1.0
    from scipy.special import bdtr

    return min(1.0, 2 * float(bdtr(min(won, lost), won + lost, 0.5)))


def _difference_with_score(won: int, lost: int, total: int, score: float) -> float:
    """Return the difference of paired rates at which the score statistic equals ``score``.

    The statistic decreases with the difference and is 0 at the observed one.
    """
    # Bisection between the observed difference and the end on the side of the score
    low, high = (-1.0, (won - lost) / total) if score > 0 else ((won - lost) / total, 1.0)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if _score(won, lost, total, middle) > score:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _score(won: int, lost: int, total: int, difference: float) -> float:
    """Return Tango's statistic (1998): the error of ``difference`` in standard errors."""
    # Constrained maximum-likelihood estimate of the rate at which only the other succeeds.
    b = -won - lost + (2 * total - won + lost) * difference
    c = -lost * difference * (1 - difference)
    rate = (math.sqrt(max(0.0, b * b - 8 * total * c)) - b) / (4 * total)
    variance = total * (2 * rate + difference * (1 - difference))
    error = won - lost - total * difference
    if variance <= 0:
        return math.copysign(math.inf, error) if error else 0.0
    return error / math.sqrt(variance)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values of M comparisons, each corrected for the others (Holm 1979).

    The probability that any of those up to 0.05 is a false discovery is at most 5 %.
    """
    corrected, largest = [1.0] * len(p_values), 0.0
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    # From the smallest p-value on; a later one is never below an earlier one.
    for rank, at in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[at]))
        corrected[at] = largest
    return corrected
