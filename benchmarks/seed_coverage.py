"""Simulate how often the intervals over training seeds contain the true value.

    python -m benchmarks.seed_coverage [--repetitions N] [--seed N] [--mix NAME] [--shape NAME]

A score is a seed's part + an episode's part + a part of both, with deviations that a mix states,
drawn from a normal distribution, an exponential one, or one of which a fifth lies far off, as where
one training in five fails; the episodes are the same for all seeds and for two methods that are
compared. The command prints the fraction of samples whose 95 % interval
contains the truth, by number of seeds. Bootstraps draw fewer samples than ``compare``, to
save time.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.coverage import contains, line, parsed
from flipperctl.api import FloatArray
from flipperctl.evaluation import seeds as seed_intervals
from flipperctl.evaluation.seeds import Scores, Statistic, interquartile_mean, means, resampled
from flipperctl.evaluation.statistics import Interval
from flipperctl.process import entry

SEEDS = (2, 3, 4, 5, 10)
"""Numbers of training seeds [-]."""
EPISODES = 30
"""Number of episodes [-]."""
RESAMPLES = 400
"""Number of bootstrap samples [-]."""
MIXES = {"episodes": (0.1, 0.5, 0.2), "alike": (0.3, 0.3, 0.3), "seeds": (0.5, 0.1, 0.1)}
"""Standard deviations of the parts of seed, episode, and both, by which of them are large."""
_QUARTILES = math.log(4 / 3), math.log(4)
_MIDDLE = 2 * (0.75 * (_QUARTILES[0] + 1) - 0.25 * (_QUARTILES[1] + 1)) - 1
"""Interquartile mean of an exponential distribution with mean 0 and deviation 1 [-]."""


@dataclass(frozen=True)
class Shape:
    """A distribution with mean 0 and deviation 1."""

    draw: Callable[[np.random.Generator, tuple[int, int]], FloatArray]
    middle: float
    """Its interquartile mean."""


SHAPES = {
    "normal": Shape(lambda rng, size: rng.normal(size=size), 0.0),
    "exponential": Shape(lambda rng, size: rng.exponential(size=size) - 1.0, _MIDDLE),
    "fifth": Shape(lambda rng, size: np.where(rng.random(size) < 0.2, 2.0, -0.5), -0.5),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table of coverages; exit with code 2 if an argument is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.seed_coverage")
    parser.add_argument("--mix", choices=MIXES, help="one mix of deviations [all]")
    parser.add_argument("--shape", choices=SHAPES, help="one distribution [all]")
    chosen = parsed(parser, arguments)
    mixes = {chosen.mix: MIXES[chosen.mix]} if chosen.mix else MIXES
    shapes = {chosen.shape: SHAPES[chosen.shape]} if chosen.shape else SHAPES
    for deviations in mixes.values():
        parts = ", ".join(f"{d:g}" for d in deviations)
        for label, shape in shapes.items():
            print(f"{label}, deviations of seed, episode, both: {parts}")
            print(line("", [f"S={count}" for count in SEEDS]))
            found = [
                coverage(deviations, shape, count, chosen.repetitions, chosen.seed)
                for count in SEEDS
            ]
            for kind in found[0]:
                print(line(kind, [one[kind] for one in found]), flush=True)
    return 0


def coverage(
    deviations: tuple[float, float, float], shape: Shape, seeds: int, repetitions: int, seed: int
) -> dict[str, float]:
    """Return the fraction of samples whose interval contains the truth, by kind of interval."""
    rng = np.random.default_rng(seed)
    middle = deviations[0] * shape.middle
    hits: dict[str, float] = {}
    for _ in range(repetitions):
        ours, theirs = _two(rng, deviations, shape, seeds)
        found: Mapping[str, tuple[Interval, float]] = {
            "mean": (seed_intervals.mean_interval(ours), 0.0),
            "difference": (seed_intervals.difference_interval(ours, theirs)[0], 0.0),
            "better": (seed_intervals.better_interval(ours, theirs), 0.5),
            "IQM": (
                seed_intervals.statistic_interval(ours, interquartile_mean, rng, RESAMPLES),
                middle,
            ),
            "mean, bootstrap-t of seeds": (_studentized(ours["scene"].mean(axis=1), rng), 0.0),
            "mean, percentile bootstrap": (
                bootstrap(ours, mean, rng),
                0.0,
            ),
            "IQM, percentile bootstrap": (
                bootstrap(ours, interquartile_mean, rng),
                middle,
            ),
        }
        for kind, (interval, truth) in found.items():
            hits[kind] = hits.get(kind, 0.0) + contains(interval, truth)
    return {kind: count / repetitions for kind, count in hits.items()}


def _two(
    rng: np.random.Generator, deviations: tuple[float, float, float], shape: Shape, seeds: int
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return the scores of two equal methods on the same episodes, each (S, E)."""
    own, ground, both = deviations
    episodes = ground * shape.draw(rng, (1, EPISODES))
    ours, theirs = (
        own * shape.draw(rng, (seeds, 1)) + episodes + both * shape.draw(rng, (seeds, EPISODES))
        for _ in range(2)
    )
    return {"scene": ours}, {"scene": theirs}


def bootstrap(scores: Scores, statistic: Statistic, rng: np.random.Generator) -> Interval:
    """Return a statistic with the percentile interval of the bootstrap: seeds, then episodes.

    Each sample draws whole seeds with replacement, and in each scene episodes with replacement,
    the same for all seeds. It contains the truth too rarely below ten seeds: 72 % at three.
    """
    low, high = np.percentile(statistic(resampled(scores, rng, RESAMPLES)), [2.5, 97.5])
    return Interval(float(statistic(means(scores))), float(low), float(high))


def mean(scores: FloatArray) -> FloatArray:
    """Return the mean over runs and tasks, (..., R, T) → (...)."""
    return np.asarray(scores.mean(axis=(-2, -1)))


def _studentized(means: FloatArray, rng: np.random.Generator) -> Interval:
    """Return the mean of seeds with the interval of the bootstrap-t (Efron 1981), episodes aside.

    It follows the skew of the seeds' means (S,), which Student's t does not. Samples of two seeds
    have no t but 0, so that two have no interval.
    """
    count, found = len(means), float(means.mean())
    if count < 3:
        return Interval(found, None, None)
    drawn = means[rng.integers(count, size=(RESAMPLES, count))]
    errors = drawn.std(axis=1, ddof=1) / math.sqrt(count)
    varied = errors > 1e-12 * max(1.0, abs(found))  # else one seed was drawn throughout
    if not varied.any():
        return Interval(found, found, found)
    low, high = np.quantile((drawn.mean(axis=1)[varied] - found) / errors[varied], [0.025, 0.975])
    error = float(means.std(ddof=1)) / math.sqrt(count)
    return Interval(found, found - float(high) * error, found - float(low) * error)


if __name__ == "__main__":
    entry.run(main)
