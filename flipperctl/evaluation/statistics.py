"""Means and rates with 95 % intervals, the summary of episodes, and differences at equal seeds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.evaluation.episode import EpisodeResult, further_measures
from flipperctl.evaluation.results import (
    Differences,
    Interval,
    Measure,
    Outcomes,
    PairedDifference,
    Passable,
    Summary,
)

RESAMPLES = 10_000
"""Number of resamples of the bootstrap [-]."""
Z = 1.959964
"""97.5 % quantile of the standard normal distribution [-]."""

Row = Mapping[str, Any]
"""A flat row of ``rollout.episode.play``."""
Pair = tuple[EpisodeResult, EpisodeResult]


def interval(values: Sequence[float]) -> Interval:
    """Return the mean of (K,) values, with the 2.5 and 97.5 % percentiles of the resampled mean.

    The resampling is seeded, so equal values give equal intervals (Efron 1979).

    Raises:
        ValueError: there are no values.
    """
    if len(values) == 0:
        raise ValueError("an interval needs at least one value")
    array = np.asarray(values, dtype=np.float64)
    rng = np.random.default_rng(0)
    # In slices, so that 10,000 resamples of a long list need little memory.
    means = np.concatenate(
        [rng.choice(array, (100, len(array))).mean(axis=1) for _ in range(RESAMPLES // 100)]
    )
    low, high = np.quantile(means, (0.025, 0.975))
    return Interval(float(array.mean()), float(low), float(high))


def proportion(count: int, total: int) -> Interval:
    """Return the rate ``count / total`` with its 95 % score interval (Wilson 1927).

    The bootstrap of equal outcomes is a point, as if five of five proved certainty; the score
    interval of five of five begins at 0.566.

    Raises:
        ValueError: there are no outcomes.
    """
    if total == 0:
        raise ValueError("a rate needs at least one outcome")
    rate, spread = count / total, Z**2 / total
    centre = (rate + spread / 2) / (1 + spread)
    half = Z * math.sqrt(rate * (1 - rate) / total + spread / (4 * total)) / (1 + spread)
    # The ends of 0 and 1 are exact; rounding would pass them by a last digit.
    low = centre - half if count > 0 else 0.0
    high = centre + half if count < total else 1.0
    return Interval(rate, low, high)


def reached(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of episodes that reached the finish."""
    return [row for row in rows if row["outcome"] == Outcome.REACHED]


def success_rate(rows: Sequence[Row]) -> float:
    """Return the fraction of the rows' episodes that reached the finish, 0 to 1.

    Raises:
        ZeroDivisionError: there are no rows.
    """
    return len(reached(rows)) / len(rows)


def summarise(terrain: str, episodes: Sequence[EpisodeResult]) -> Summary:
    """Return the summary of one policy's episodes on a terrain.

    Raises:
        ValueError: there are no episodes.
    """
    parts = {label: _summary(label, part, {}) for label, part in _parts(episodes).items()}
    return _summary(terrain, episodes, parts)


def _parts(episodes: Sequence[EpisodeResult]) -> dict[str, list[EpisodeResult]]:
    """Return the episodes of each kind of terrain, if there is more than one kind."""
    labels = sorted({e.terrain for e in episodes})
    if len(labels) < 2:
        return {}
    return {label: [e for e in episodes if e.terrain == label] for label in labels}


def _summary(
    terrain: str, episodes: Sequence[EpisodeResult], parts: Mapping[str, Summary]
) -> Summary:
    success = _success(episodes)
    good = [e for e in episodes if e.reached]
    return Summary(
        terrain,
        len(episodes),
        success_rate=len(good) / len(episodes),
        success=success,
        outcomes=Outcomes.of(e.outcome for e in episodes),
        t_cost=_measure([e.t_cost for e in good]),
        pitch_variation=_measure([e.pitch_variation for e in good]),
        pitch_variation_100hz=_measure([e.pitch_variation_100hz for e in good]),
        flipper_travel=_measure([e.flipper_travel for e in good]),
        max_pitch=measure([e.max_pitch for e in episodes]),
        episode_return=measure([e.episode_return for e in episodes]),
        further={
            m.name: _measure([e.further[m.name] for e in (good if m.reached_only else episodes)])
            for m in further_measures()
        },
        passable=_passable(episodes, len(good)),
        parts=parts,
        search=_search(episodes),
    )


def _search(episodes: Sequence[EpisodeResult]) -> dict[str, float | Mapping[str, int]]:
    """Return the mean of each number that the searches reported, and the counts of each word."""
    found: dict[str, float | Mapping[str, int]] = {}
    for name in episodes[0].search:
        values = [e.search[name] for e in episodes if name in e.search]
        words = [value for value in values if isinstance(value, str)]
        numbers = [value for value in values if not isinstance(value, str)]
        found[name] = dict(Counter(words).most_common()) if words else sum(numbers) / len(numbers)
    return found


def _success(episodes: Sequence[EpisodeResult]) -> Interval:
    return proportion(sum(e.reached for e in episodes), len(episodes))


def _passable(episodes: Sequence[EpisodeResult], reached: int) -> Passable | None:
    if all(e.crossed_by is None for e in episodes):
        return None
    # An episode that no policy is known to cross is no evidence against this one.
    fair = [e for e in episodes if e.crossed_by]
    if not fair:
        return Passable(0, None, None)
    return Passable(len(fair), reached / len(fair), _success(fair))


def measure(values: Sequence[float]) -> Measure:
    """Return the interval of (K,) values, and their range.

    Raises:
        ValueError: there are no values.
    """
    found = interval(values)
    return Measure(found.mean, found.low, found.high, float(max(values) - min(values)))


def _measure(values: Sequence[float]) -> Measure | None:
    return measure(values) if values else None


def differences(ours: Sequence[EpisodeResult], theirs: Sequence[EpisodeResult]) -> Differences:
    """Return the mean differences of the paper's measures, ours minus theirs, at equal seeds."""
    parts = {label: _differences(paired(part, theirs), {}) for label, part in _parts(ours).items()}
    return _differences(paired(ours, theirs), parts)


def paired(ours: Sequence[EpisodeResult], theirs: Sequence[EpisodeResult]) -> list[Pair]:
    """Return the pairs of episodes of equal seeds in which both reached the finish."""
    others = {e.seed: e for e in theirs if e.reached}
    return [(e, others[e.seed]) for e in ours if e.reached and e.seed in others]


def _differences(pairs: Sequence[Pair], parts: Mapping[str, Differences]) -> Differences:
    return Differences(
        t_cost=_difference(pairs, lambda e: e.t_cost),
        pitch_variation=_difference(pairs, lambda e: e.pitch_variation),
        pitch_variation_100hz=_difference(pairs, lambda e: e.pitch_variation_100hz),
        parts=parts,
    )


def _difference(
    pairs: Sequence[Pair], value: Callable[[EpisodeResult], float]
) -> PairedDifference | None:
    if not pairs:
        return None
    found = interval([value(mine) - value(other) for mine, other in pairs])
    return PairedDifference(found.mean, found.low, found.high, len(pairs))
