"""Medians, quartiles and ratios of measured values.

In: one number per round, or None for a run that did not finish in time, which counts as larger
than any number. Out: plain dictionaries for the JSON document, with the raw numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Values = Sequence[float | None]


def quantity(values: Values, unit: str) -> dict[str, Any]:
    """Return median and quartiles; one that falls on a run without a number is None."""
    low, median, high = (_finite(quantile(values, q)) for q in (0.25, 0.5, 0.75))
    return {"unit": unit, "median": median, "low": low, "high": high, "values": list(values)}


def ratio(numerator: Values, denominator: Values) -> dict[str, Any]:
    """Return the ratio of the medians, and the quartiles of the ratios of the rounds.

    The ratio is None if a median is None. Rounds in which both values are None are left out.
    """
    medians = quantile(numerator, 0.5), quantile(denominator, 0.5)
    ratios = [_divided(a, b) for a, b in zip(numerator, denominator, strict=True)]
    known = [value for value in ratios if not math.isnan(value)]
    low, high = (_finite(quantile(known, q)) if known else None for q in (0.25, 0.75))
    of_medians = medians[0] / medians[1] if all(map(math.isfinite, medians)) else None
    return {"ratio": of_medians, "low": low, "high": high, "rounds": len(known)}


def quantile(values: Values, q: float) -> float:
    """Return the quantile, interpolated linearly, with None counted as infinite."""
    ordered = sorted(math.inf if v is None else float(v) for v in values)
    position = q * (len(ordered) - 1)
    index = math.floor(position)
    fraction = position - index
    if fraction == 0:
        return ordered[index]
    lower, upper = ordered[index], ordered[index + 1]
    return math.inf if math.isinf(upper) else lower + fraction * (upper - lower)


def measure_in_turn(
    contestants: Mapping[str, Callable[[], float]],
    rounds: int,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> dict[str, list[float]]:
    """Run all contestants in each round (A B A B …); return the results of each, by round.

    They take turns so that a temporarily slow machine slows all of them. ``report_progress`` is
    called with the finished fraction of the rounds.
    """
    found: dict[str, list[float]] = {name: [] for name in contestants}
    for index in range(rounds):
        for name, run in contestants.items():
            found[name].append(run())
        report_progress((index + 1) / rounds)
    return found


def _divided(numerator: float | None, denominator: float | None) -> float:
    if numerator is None:
        return math.nan if denominator is None else math.inf
    return 0.0 if denominator is None else numerator / denominator


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
