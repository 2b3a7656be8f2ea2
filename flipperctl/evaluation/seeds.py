"""Training seeds: scores of methods, and intervals over seeds and episodes together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray
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

It is a choice, not a measurement: 1 % of failures weighs as much as 0.06 rad.
"""


@dataclass(frozen=True)
class SeedSamples:
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

    def on(self, scene: str) -> SeedSamples:
        """Return the episodes of one scene."""
        values, reached = {scene: self.values[scene]}, {scene: self.reached[scene]}
        return SeedSamples(self.name, values, reached, self.trained)

    def scores(self, price: float) -> dict[str, FloatArray]:
        """Return the scores by scene, (S, E): the measure, or the price if not reached.

        A crossing costs the price at most, so that failing never pays. The price is the same
        whatever other methods do, so that no other method changes a score.
        """
        return {
            scene: np.where(self.reached[scene], np.minimum(values, price), price)
            for scene, values in self.values.items()
        }

    def crossings(self) -> dict[str, FloatArray]:
        """Return the measure of the episodes that all seeds reached, by scene, (S, E')."""
        return {k: v[:, self.reached[k].all(axis=0)] for k, v in self.values.items()}

    def successes(self) -> dict[str, FloatArray]:
        """Return 1 for reached and 0 for other episodes, by scene, (S, E)."""
        return {scene: reached.astype(np.float64) for scene, reached in self.reached.items()}


def means(scores: Mapping[str, FloatArray]) -> FloatArray:
    """Return the mean score of each training seed on each scene, (S, K)."""
    return np.column_stack([values.mean(axis=1) for values in scores.values()])


def success_interval(method: SeedSamples) -> Interval:
    """Return the success rate, the mean of those of the scenes.

    One seed, and seeds that agree everywhere, have the score interval of all episodes.
    """
    rates = method.successes()
    episodes = sum(values.shape[1] for values in rates.values())
    mean = float(np.mean([values.mean() for values in rates.values()]))
    # Nothing varies over seeds: the score interval of one rate
    if mean in (0.0, 1.0) or method.seeds == 1:
        of_all = proportion(round(mean * episodes), episodes)
        return Interval(mean, of_all.low, of_all.high)
    interval = mean_interval(rates)
    if interval.low is None or interval.high is None:
        return interval
    # Seeds agree within every scene, but episodes vary.
    if interval.low == interval.high:
        counts = [(round(float(v.mean()) * v.shape[1]), v.shape[1]) for v in rates.values()]
        return mean_of([proportion(reached, total) for reached, total in counts])
    return within(interval, 0.0, 1.0)


def within(estimate: Interval, least: float, most: float) -> Interval:
    """Return an interval of what lies between two numbers.

    Values that do not vary, such as the price of failures alone, have none: they do not tell how
    others would.
    """
    if estimate.low is None or estimate.high is None or estimate.low == estimate.high:
        return Interval(estimate.mean, None, None)
    return Interval(estimate.mean, max(least, estimate.low), min(most, estimate.high))


def success_difference(
    method: SeedSamples, baseline: SeedSamples
) -> tuple[Interval | PairedSuccess, float]:
    """Return a method's success minus a baseline's, with its interval and its p-value.

    Training seeds and episodes both vary.

    If the interval has no width (all seeds agree), one seed's episodes have one: the score interval
    of each scene and McNemar's exact test. If the seeds' episodes differ, there is none.
    """
    # On a single scene where the seeds agree, this is a plain paired comparison.
    if len(method.reached) == 1 and _agree(method) and _agree(baseline):
        (mine,), (other,) = method.reached.values(), baseline.reached.values()
        paired = _pair(mine[0], other[0])
        return paired, paired.p
    # Where seeds vary, their variance makes the interval.
    interval, p = difference_interval(method.successes(), baseline.successes())
    if interval.low is None or interval.high is None:
        return interval, p
    if interval.low < interval.high:
        return Interval(interval.mean, max(-1.0, interval.low), min(1.0, interval.high)), p
    if not (_agree(method) and _agree(baseline)):
        return Interval(interval.mean, None, None), 1.0
    # Paired intervals for each scene, and one exact test over all of them
    pairs = [
        _pair(values[0], others[0])
        for values, others in zip(method.reached.values(), baseline.reached.values(), strict=True)
    ]
    won, lost = (sum(getattr(pair, name) for pair in pairs) for name in ("won", "lost"))
    return mean_of(pairs), mcnemar_p(won, lost)


def _agree(method: SeedSamples) -> bool:
    """Return whether all seeds reach the finish in the same episodes; a single one does."""
    return all((values == values[0]).all() for values in method.reached.values())


def _pair(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> PairedSuccess:
    return paired_success(int(np.sum(first & ~second)), int(np.sum(second & ~first)), len(first))


Statistic = Callable[[FloatArray], FloatArray]
"""Returns one number for each matrix of scores, (..., R, T) → (...)."""
RESAMPLES = 2000  # number of bootstrap samples [-]
FEWEST_SEEDS = 5
"""Number of seeds from which Satterthwaite's interval contains the truth in 95 ± 1 % [-]."""
_FLAT = 1e-9
"""Error of an estimate, relative to it, below which its values are equal but for rounding [-]."""
_HALVINGS = 40  # halvings by which a p-value is found [-]
FEWEST_EPISODES = 5  # smallest number of episodes of a scene for an interval [-]

Scores = Mapping[str, FloatArray]
"""Scores by scene, (S, E): the same S training seeds in each scene."""


@dataclass(frozen=True)
class Part:
    """One part of the variance of an estimate."""

    variance: float
    freedom: float
    """Degrees of freedom of its estimate [-]."""


def mean_interval(scores: Scores) -> Interval:
    """Return the mean over scenes, seeds and episodes with its interval.

    With one seed it describes the variation over episodes alone.
    """
    return _interval(float(np.mean(means(scores))), *_parts(scores))


def score_interval(
    method: SeedSamples, price: float, interval: Callable[[Scores], Interval] = mean_interval
) -> Interval:
    """Return the mean score with an interval that counts on failures that were not seen.

    ``interval`` may be that of another statistic of the scores.

    In 30 episodes of a method that fails in 3 %, none fails with a probability of 0.4. The interval
    of the rate of failures, by the episodes of one seed, therefore adds to that of the crossings
    (as squares; Zou & Donner 2008). No end is inside the interval of the scores themselves.
    """
    scores, crossings = method.scores(price), dict[str, FloatArray]()
    rates: list[Interval] = []
    for scene, values in scores.items():
        reached = method.reached[scene]
        mean = float(values[reached].mean()) if reached.any() else price
        crossings[scene] = np.where(reached, values, mean)
        # What the rate of failures leaves open, in the score of the scene
        episodes = values.shape[1]
        rate = proportion((1.0 - float(reached.mean())) * episodes, episodes)
        rates.append(rate.scaled(price - mean))
    whole, crossed = interval(scores), interval(crossings)
    if whole.low is None or whole.high is None or whole.low == whole.high:
        return whole
    open_rate = mean_of(rates)
    below, above = np.hypot(crossed.distances, open_rate.distances).tolist()
    return Interval(
        whole.mean, min(whole.low, whole.mean - below), max(whole.high, whole.mean + above)
    )


def difference_interval(scores: Scores, baseline: Scores) -> tuple[Interval, float]:
    """Return a mean minus a baseline's on the same episodes, with its interval and its p-value.

    The training seeds of the two are independent of each other; the episodes are pairs.
    """
    mine, other = _parts(scores), _parts(baseline)
    paired = {k: scores[k].mean(axis=0) - baseline[k].mean(axis=0) for k in scores}
    seeds = [part for part in (mine[0], other[0]) if part is not None]
    rest = mine[2] + other[2]
    mean = float(np.mean(means(scores)) - np.mean(means(baseline)))
    return _tested(mean, seeds, _over_episodes(paired), rest)


def better_interval(scores: Scores, baseline: Scores) -> Interval:
    """Return how often a seed has a smaller score on an episode than one of the baseline's.

    Ties count one half. Averaged over all pairs of seeds, episodes and scenes, with its interval.
    Two to four seeds have none: where seeds differ much, all win or none, which says nothing of
    the variation of others. Nor have episodes that all say the same.
    """
    # Every seed against every other one, on equal episodes
    gaps = {k: baseline[k][None, :, :] - scores[k][:, None, :] for k in scores}  # (S, S', E)
    wins = {k: (gap > 0) + 0.5 * (gap == 0) for k, gap in gaps.items()}
    mean = float(np.mean([w.mean() for w in wins.values()]))
    mine = _parts({k: w.mean(axis=1) for k, w in wins.items()})
    other = _parts({k: w.mean(axis=0) for k, w in wins.items()})
    episodes = _over_episodes({k: w.mean(axis=(0, 1)) for k, w in wins.items()})
    seeds = [part for part in (mine[0], other[0]) if part is not None]
    interval, _ = _tested(mean, seeds, episodes, mine[2] + other[2])
    # Few seeds that all win say nothing about further ones.
    few = any(part.freedom + 1 < FEWEST_SEEDS for part in seeds)
    if few or interval.low is None or interval.high is None or interval.low == interval.high:
        return Interval(mean, None, None)
    return Interval(mean, max(0.0, interval.low), min(1.0, interval.high))


def statistic_interval(
    scores: Scores, statistic: Statistic, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """Return a statistic of the seeds' means, such as the interquartile mean, with its interval.

    The part of the seeds is the variance of the statistic over bootstrap samples of whole seeds. It
    is multiplied by S / (S - 1), since a bootstrap of few values is too narrow. The part of the
    episodes comes from the jackknife in each scene.
    """
    seed_means = means(scores)
    count = len(seed_means)
    estimate = float(statistic(seed_means))
    _, _, rest = _parts(scores)
    seeds: Part | None = None
    # Whole seeds are drawn, since a policy plays all scenes.
    if count > 1:
        rows = rng.integers(count, size=(resamples, count))
        spread = float(np.var(statistic(seed_means[rows]))) * count / (count - 1)
        seeds = Part(spread, count - 1)
    return _interval(estimate, seeds, _jackknifed(scores, statistic), rest)


def resampled(scores: Scores, rng: np.random.Generator, resamples: int) -> FloatArray:
    """Return means of resampled seeds on resampled episodes, (B, S, K).

    Scores of (S, E, L), such as one for each of L levels, give (B, S, L, K).
    """
    count = len(next(iter(scores.values())))
    # The same seeds in all scenes, other episodes in each
    rows = rng.integers(count, size=(resamples, count))  # seeds first: one policy, all scenes
    columns = []
    for values in scores.values():
        weights = rng.multinomial(
            values.shape[1], np.full(values.shape[1], 1 / values.shape[1]), size=resamples
        )  # how often each episode was drawn, (B, E)
        drawn = np.tensordot(weights / values.shape[1], values, (1, 1))  # (B, S, ...)
        columns.append(drawn[np.arange(resamples)[:, None], rows])
    return np.stack(columns, axis=-1)


def _parts(scores: Scores) -> tuple[Part | None, Part | None, float]:
    """Return the parts of the mean's variance: over seeds, over episodes, and of both.

    The first two contain the third each; it is the variance of what neither seed nor episode
    explains. A part is None where there is one seed, or where episodes are too few.
    """
    seed_means = means(scores)
    count, scenes = seed_means.shape
    episodes = _over_episodes({k: values.mean(axis=0) for k, values in scores.items()})
    if count < 2:
        return None, episodes, 0.0
    # Over seeds: the variance of their means over all scenes
    seeds = Part(float(np.var(seed_means.mean(axis=1), ddof=1)) / count, count - 1)
    rest = 0.0
    # What neither seed nor episode explains, from the residuals of both means
    for values in scores.values():
        if (size := values.shape[1]) > 1:
            left = values - values.mean(axis=1, keepdims=True) - values.mean(axis=0) + values.mean()
            square = float(np.sum(left**2)) / ((count - 1) * (size - 1))
            rest += square / (count * size) / scenes**2
    return seeds, episodes, rest


def _over_episodes(values: Mapping[str, FloatArray]) -> Part | None:
    """Return the part of the episodes from one value for each, (E,) by scene."""
    if min(len(scores) for scores in values.values()) < FEWEST_EPISODES:
        return None
    each = [
        Part(float(np.var(scores, ddof=1)) / len(scores) / len(values) ** 2, len(scores) - 1)
        for scores in values.values()
    ]
    return _joined(each)


def _jackknifed(scores: Scores, statistic: Statistic) -> Part | None:
    """Return the variance of the statistic over episodes by the jackknife in each scene."""
    seed_means, each = means(scores), []
    for at, values in enumerate(scores.values()):
        size = values.shape[1]
        if size < FEWEST_EPISODES:
            return None
        # The statistic without each episode in turn
        without = np.repeat(seed_means[None], size, axis=0)  # (E, S, K)
        without[:, :, at] = ((values.sum(axis=1, keepdims=True) - values) / (size - 1)).T
        estimates = statistic(without)
        spread = (size - 1) / size * float(np.sum((estimates - estimates.mean()) ** 2))
        each.append(Part(spread, size - 1))
    return _joined(each)


def _joined(parts: Sequence[Part]) -> Part:
    """Return the sum of independent parts with Satterthwaite's degrees of freedom."""
    total = sum(part.variance for part in parts)
    below = sum(part.variance**2 / part.freedom for part in parts)
    return Part(total, total**2 / below if below > 0 else sum(part.freedom for part in parts))


def _interval(estimate: float, seeds: Part | None, episodes: Part | None, rest: float) -> Interval:
    return _tested(estimate, [] if seeds is None else [seeds], episodes, rest)[0]


def _tested(
    estimate: float, seeds: Sequence[Part], episodes: Part | None, rest: float
) -> tuple[Interval, float]:
    """Return an estimate with its interval, and the two-sided p-value for 0."""
    if episodes is None:
        return Interval(estimate, None, None), 1.0
    parts = [*seeds, episodes]
    # The residual is in both sums; the estimate of the variance must not fall below either.
    variance = max(_joined(parts).variance - rest, *(part.variance for part in parts))
    if variance <= (_FLAT * max(1.0, abs(estimate))) ** 2:
        return Interval(estimate, estimate, estimate), 0.0 if estimate else 1.0
    # Few seeds: Satterthwaite's interval would be too narrow.
    if any(part.freedom + 1 < FEWEST_SEEDS for part in seeds):
        half, p = _cautious(estimate, parts, rest)
        return Interval(estimate, estimate - half, estimate + half), p
    # Satterthwaite's degrees of freedom; the subtracted rest has an error of its own.
    below = sum(part.variance**2 / part.freedom for part in parts)
    if seeds and rest > 0:
        below += rest**2 / (sum(part.freedom for part in seeds) * episodes.freedom)
    from scipy.special import stdtr, stdtrit

    freedom, error = variance**2 / below, math.sqrt(variance)
    half = float(stdtrit(freedom, 0.975)) * error
    p = 2 * float(stdtr(freedom, -abs(estimate) / error))
    return Interval(estimate, estimate - half, estimate + half), p


def _cautious(estimate: float, parts: Sequence[Part], rest: float) -> tuple[float, float]:
    """Return half the width of the interval of few seeds, and the p-value for 0.

    Each part has the quantile of its own degrees of freedom (Cochran 1964), the episodes' being the
    last one. The interval is never too narrow, where Satterthwaite's is: 88 % at two seeds.
    """
    from scipy.special import stdtrit

    # The rest is in the seeds' part and in the episodes'; it counts once.
    freedoms = np.array([part.freedom for part in parts])
    variances = np.array([part.variance for part in parts])
    pure = np.append(variances[:-1], max(0.0, variances[-1] - rest))

    def half(p: float) -> float:
        squares = stdtrit(freedoms, 1 - p / 2) ** 2
        return math.sqrt(max(float(squares @ pure), float((squares * variances).max())))

    low, high = 0.0, 1.0  # the p-value is where the interval ends at 0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if half(middle) > abs(estimate) else (low, middle)
    return half(0.05), high


def interquartile_mean(scores: FloatArray) -> FloatArray:
    """Return the mean of the middle half of all runs and tasks, (..., R, T) → (...).

    The ⌊R·T/4⌋ smallest and equally many of the largest scores are left out, so it equals the mean
    for up to three scores.
    """
    flat = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = flat.shape[-1] // 4
    return np.asarray(flat[..., cut : flat.shape[-1] - cut].mean(axis=-1))


def improvement(scores: FloatArray, baseline: FloatArray) -> FloatArray:
    """Return the probability that a run beats one of the baseline's, where greater is better.

    It is P(X > Y) + P(X = Y) / 2 over all pairs of runs (Mann and Whitney's U over R·R'). The mean
    over the tasks is returned: (..., R, T) and (..., R', T) → (...).
    """
    gap = scores[..., :, None, :] - baseline[..., None, :, :]  # (..., R, R', T)
    return np.asarray(((gap > 0) + 0.5 * (gap == 0)).mean(axis=(-3, -2, -1)))


def profile(scores: FloatArray, levels: FloatArray) -> FloatArray:
    """Return the fraction of all scores above each of L levels, (L,): the performance profile.

    ``scores`` may have any shape: runs × tasks, as in rliable, or runs × episodes.
    """
    ordered = np.sort(scores, axis=None)
    below = np.searchsorted(ordered, levels, side="right")
    return np.asarray(1.0 - below / ordered.size)
