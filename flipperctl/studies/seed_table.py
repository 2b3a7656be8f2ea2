"""Methods compared over their training seeds: scores, interquartile means and improvements.

In: methods with the episodes of each training seed. Out: a row for each method, compared with one
of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.evaluation.aggregates import improvement, interquartile_mean
from flipperctl.evaluation.estimates import Interval, PairedSuccess
from flipperctl.evaluation.intervals import (
    holm,
    mcnemar_p,
    mean_of,
    paired_success,
    proportion,
)
from flipperctl.evaluation.power import paired_episodes, success_episodes
from flipperctl.evaluation.scores import Method, means
from flipperctl.evaluation.seed_intervals import (
    better_interval,
    difference_interval,
    mean_interval,
    statistic_interval,
)

_SEED = 0
"""Seed of the bootstrap."""


@dataclass(frozen=True)
class Comparison:
    """A method minus another one, on the same episodes."""

    against: str
    score: Interval
    """Difference of the mean scores; below 0 the method is better."""
    p: float
    """Two-sided p-value of that difference [-]."""
    p_holm: float
    """The same, corrected for all methods of the table (Holm) [-]."""
    success: Interval | PairedSuccess
    """Difference of the success rates."""
    p_success: float
    p_success_holm: float
    improvement: float
    """Probability that a training seed has a better mean score on a scene than one of the other
    method, averaged over scenes (rliable's probability of improvement) [-]."""
    better: Interval
    """Probability that a seed has a better score than one of the other method on an episode [-]."""
    needed: int | None = None
    """Number of episodes that show the asked difference of the score, for these policies."""
    needed_success: int | None = None
    """Number of episodes that show the asked difference of success, for these policies."""


@dataclass(frozen=True)
class MethodRow:
    """What one method reaches."""

    method: str
    seeds: int
    """Number of training seeds."""
    trained: bool
    """Whether its policies were trained; False for a rule."""
    success: Interval
    score: Interval
    """Mean score over scenes, seeds and episodes."""
    iqm: Interval
    """Interquartile mean over the mean scores of seeds and scenes."""
    reached_mean: float | None
    """Mean of the measure over the episodes that were reached; None if none was."""
    above_price: int
    """Number of reached episodes that cost more than one that was not reached."""
    by_scene: Mapping[str, Interval]
    """Mean score on each scene."""
    comparison: Comparison | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def rows(
    methods: Sequence[Method],
    price: float,
    against: Method,
    *,
    detect: float | None = None,
    detect_success: float | None = None,
) -> list[MethodRow]:
    """Return a row for each method, in their order.

    ``detect`` and ``detect_success``: differences of score and of success whose number of episodes
    is asked for.
    """
    found = [_row(method, price) for method in methods]
    compared = [
        _compare(method, against, price, detect, detect_success)
        for method in methods
        if method is not against
    ]
    scores = holm([c.p for c in compared])
    successes = holm([c.p_success for c in compared])
    corrected = iter(
        replace(c, p_holm=p, p_success_holm=q)
        for c, p, q in zip(compared, scores, successes, strict=True)
    )
    return [
        row if method is against else replace(row, comparison=next(corrected))
        for row, method in zip(found, methods, strict=True)
    ]


def _row(method: Method, price: float) -> MethodRow:
    scores = method.scores(price)
    reached = np.concatenate(
        [values[method.reached[scene]] for scene, values in method.values.items()]
    )
    rng = np.random.default_rng(_SEED)
    every = np.concatenate([values.ravel() for values in scores.values()])
    ends = min(0.0, float(every.min())), max(price, float(every.max()))
    return MethodRow(
        method.name,
        method.seeds,
        method.trained,
        success=_success(method),
        score=_within(mean_interval(scores), *ends),
        iqm=_within(statistic_interval(scores, interquartile_mean, rng), *ends),
        reached_mean=float(reached.mean()) if reached.size else None,
        above_price=method.above(price),
        by_scene={
            scene: _within(mean_interval({scene: values}), *ends)
            for scene, values in scores.items()
        },
    )


def _success(method: Method) -> Interval:
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
    return _within(found, 0.0, 1.0)


def _within(found: Interval, least: float, most: float) -> Interval:
    """Return an interval of what lies between two numbers.

    Values that do not vary, such as the price of failures alone, have none: they do not tell how
    others would.
    """
    if found.low is None or found.high is None or found.low == found.high:
        return Interval(found.mean, None, None)
    return Interval(found.mean, max(least, found.low), min(most, found.high))


def _compare(
    method: Method,
    other: Method,
    price: float,
    detect: float | None,
    detect_success: float | None,
) -> Comparison:
    ours, theirs = method.scores(price), other.scores(price)
    score, p = difference_interval(ours, theirs)
    if score.low is not None and score.low == score.high:
        score, p = Interval(score.mean, None, None), 1.0
    success: Interval | PairedSuccess
    if len(method.reached) == 1 and _agree(method) and _agree(other):
        success = _paired(method, other)
        p_success = success.p
    else:
        success, p_success = _success_difference(method, other)
    return Comparison(
        other.name,
        score,
        p,
        p,
        success,
        p_success,
        p_success,
        improvement=float(improvement(-means(ours), -means(theirs))),
        better=better_interval(ours, theirs),
        needed=None if detect is None else _needed(method, other, price, detect),
        needed_success=None
        if detect_success is None
        else success_episodes(detect_success, _unequal(method, other)),
    )


def _success_difference(method: Method, other: Method) -> tuple[Interval, float]:
    """Return the difference of success over seeds and episodes, and its p-value.

    Where no episode and no seed makes a difference that another does not, they are those of one
    seed: the score intervals of the scenes and McNemar's exact test; none if the seeds' episodes
    differ all the same.
    """
    found, p = difference_interval(method.successes(), other.successes())
    if found.low is None or found.high is None:
        return found, p
    if found.low < found.high:
        return Interval(found.mean, max(-1.0, found.low), min(1.0, found.high)), p
    if not (_agree(method) and _agree(other)):
        return Interval(found.mean, None, None), 1.0
    pairs = [
        _pair(values[0], theirs[0])
        for values, theirs in zip(method.reached.values(), other.reached.values(), strict=True)
    ]
    won, lost = (sum(getattr(pair, name) for pair in pairs) for name in ("won", "lost"))
    return mean_of(pairs), mcnemar_p(won, lost)


def _agree(method: Method) -> bool:
    """Return whether all seeds reach the finish in the same episodes; a single one does."""
    return all((values == values[0]).all() for values in method.reached.values())


def _paired(method: Method, other: Method) -> PairedSuccess:
    """Return the difference of success on one scene, of one seed each or of seeds that agree."""
    (ours,), (theirs,) = method.reached.values(), other.reached.values()
    return _pair(ours[0], theirs[0])


def _pair(ours: NDArray[np.bool_], theirs: NDArray[np.bool_]) -> PairedSuccess:
    return paired_success(int(np.sum(ours & ~theirs)), int(np.sum(theirs & ~ours)), len(ours))


def _needed(method: Method, other: Method, price: float, difference: float) -> int | None:
    """Return the episodes that show a difference, from the deviation of the seeds' mean scores."""
    ours, theirs = method.scores(price), other.scores(price)
    gaps = [ours[k].mean(axis=0) - theirs[k].mean(axis=0) for k in ours]
    freedom = sum(len(gap) - 1 for gap in gaps)
    if freedom < 1:
        return None
    square = sum(float(np.sum((gap - gap.mean()) ** 2)) for gap in gaps) / freedom
    return paired_episodes(difference, square**0.5)


def _unequal(method: Method, other: Method) -> float:
    """Return the fraction of episodes that a seed of one reaches and a seed of the other not."""
    found = [
        (method.reached[k][:, None, :] != other.reached[k][None, :, :]).mean()
        for k in method.reached
    ]
    return float(np.mean(found))
