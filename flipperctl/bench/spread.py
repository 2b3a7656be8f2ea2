"""Medians, quartiles and ratios of what was measured in turn.

In: one number a round; None where a run did not get there in time, which counts as longer than
any number. Out: plain dictionaries for the JSON document, the raw numbers among them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Values = Sequence[float | None]


def quantity(values: Values, unit: str) -> dict[str, Any]:
    """Median and quartiles; each is None where it lies among the runs without a number."""
    low, median, high = (_finite(quantile(values, q)) for q in (0.25, 0.5, 0.75))
    return {"unit": unit, "median": median, "low": low, "high": high, "values": list(values)}


def ratio(above: Values, below: Values) -> dict[str, Any]:
    """The ratio of the medians, with the quartiles of the ratios round by round.

    None where a median has no number; a round in which neither has one is left out.
    """
    medians = quantile(above, 0.5), quantile(below, 0.5)
    pairs = [_divided(a, b) for a, b in zip(above, below, strict=True)]
    known = [pair for pair in pairs if not math.isnan(pair)]
    low, high = (_finite(quantile(known, q)) if known else None for q in (0.25, 0.75))
    whole = medians[0] / medians[1] if all(map(math.isfinite, medians)) else None
    return {"ratio": whole, "low": low, "high": high, "rounds": len(known)}


def quantile(values: Values, share: float) -> float:
    """The quantile, linear between neighbours; infinite among values that are None."""
    ordered = sorted(math.inf if v is None else float(v) for v in values)
    place = share * (len(ordered) - 1)
    below = math.floor(place)
    part = place - below
    if part == 0:
        return ordered[below]
    lower, upper = ordered[below], ordered[below + 1]
    return math.inf if math.isinf(upper) else lower + part * (upper - lower)


def in_turn(
    contestants: Mapping[str, Callable[[], float]],
    rounds: int,
    tell: Callable[[float], None] = lambda share: None,
) -> dict[str, list[float]]:
    """What each contestant returned, round by round (A B A B …).

    In turn, so that a machine that slows down for a while slows all of them.
    """
    found: dict[str, list[float]] = {name: [] for name in contestants}
    for index in range(rounds):
        for name, run in contestants.items():
            found[name].append(run())
        tell((index + 1) / rounds)
    return found


def _divided(above: float | None, below: float | None) -> float:
    if above is None:
        return math.nan if below is None else math.inf
    return 0.0 if below is None else above / below


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
