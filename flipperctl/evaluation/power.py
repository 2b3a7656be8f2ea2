"""The number of episodes that shows a stated difference with a stated power, and the reverse.

In: what an earlier evaluation found: the standard deviation of paired differences, or how often
one policy alone reached the finish. Out: numbers of episodes. Tests are two-sided at 5 %: the
paired t test, and McNemar's exact test, as ``intervals`` computes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

POWER = 0.8
"""Probability with which a difference that exists is to be seen [-]."""
MOST = 100_000
"""Largest number of episodes that is searched [-]."""
_ALPHA = 0.05
_TAIL = 1e-12
"""Probability of the counts that a sum leaves out [-]."""


def paired_power(difference: float, deviation: float, episodes: int) -> float:
    """Return the power of the paired t test for a mean ``difference`` of ``episodes`` pairs.

    ``deviation`` is the standard deviation of the pairs' differences, in the same unit.
    """
    from scipy.stats import nct, t  # special.nctdtr errs by 1e-8

    if deviation == 0:
        return 1.0 if difference else _ALPHA
    freedom, shift = episodes - 1, abs(difference) / deviation * math.sqrt(episodes)
    limit = float(t.isf(_ALPHA / 2, freedom))
    upper, lower = float(nct.sf(limit, freedom, shift)), float(nct.cdf(-limit, freedom, shift))
    # SciPy returns NaN for far tails: the upper is then 1 and the lower 0 within rounding.
    return (1.0 if math.isnan(upper) else upper) + (0.0 if math.isnan(lower) else lower)


def paired_episodes(difference: float, deviation: float, power: float = POWER) -> int | None:
    """Return the smallest number of pairs whose t test shows a mean ``difference``.

    None: more than ``MOST``.

    Raises:
        ValueError: the difference is 0.
    """
    if difference == 0:
        raise ValueError("a difference of 0 cannot be shown; any other number is allowed")
    return _smallest(lambda n: paired_power(difference, deviation, n), power)


def success_power(won: float, lost: float, episodes: int) -> float:
    """Return the power of McNemar's exact test for ``episodes`` pairs.

    ``won`` and ``lost``: rates at which only the first, or only the second, reaches the finish.
    """
    from scipy.stats import binom

    either = won + lost
    if either == 0:
        return 0.0
    counts = np.arange(episodes + 1)
    chance = binom.pmf(counts, episodes, either)
    kept = counts[chance > _TAIL]
    # The largest count of the rarer side at which the test with n unequal pairs rejects.
    limit = binom.ppf(_ALPHA / 2, kept, 0.5)
    limit = np.where(2 * binom.cdf(limit, kept, 0.5) > _ALPHA, limit - 1, limit)
    share = won / either
    rejects = binom.cdf(limit, kept, share) + binom.cdf(limit, kept, 1 - share)
    return float(np.sum(chance[kept] * np.where(limit >= 0, rejects, 0.0)))


def success_episodes(difference: float, unequal: float, power: float = POWER) -> int | None:
    """Return the smallest number of pairs whose McNemar test shows a difference of success.

    ``unequal``: the rate of episodes that only one of the two reaches. It is raised to the
    difference if it is smaller. The power of an exact test is a saw-tooth: that of slightly larger
    numbers may be lower by up to 0.05. None: more than ``MOST``.

    Raises:
        ValueError: the difference is not in (0, 1].
    """
    if not 0 < difference <= 1:
        raise ValueError(f"a difference of success in (0, 1] is allowed; got {difference:g}")
    either = min(1.0, max(unequal, difference))
    won = (either + difference) / 2
    return _smallest(lambda n: success_power(won, either - won, n), power)


def _smallest(power_of: Callable[[int], float], power: float) -> int | None:
    """Return the smallest number from 2 whose power suffices, by doubling and halving."""
    low, high = 1, 2
    while power_of(high) < power:
        low, high = high, 2 * high
        if high > 2 * MOST:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        if power_of(middle) < power:
            low = middle
        else:
            high = middle
    return high if high <= MOST else None
