"""Simulate how often the 95 % intervals of evaluations contain the true value.

    python -m benchmarks.coverage [episodes.csv ...] [--repetitions N] [--seed N]

For each distribution and number of values, it computes the intervals of many samples and prints the
fraction that contains the distribution's mean. A file written by ``eval --output`` adds θ̂_R at
100 Hz of the episodes that reached the finish, by scene and method, and the paired differences of
two methods. Samples are drawn from these with replacement, so that their mean is the true value.
The coverage of rates and of differences of paired rates is computed exactly.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from flipperctl.api import FloatArray, Outcome
from flipperctl.evaluation.plan import is_best_known
from flipperctl.evaluation.statistics import Interval, interval, paired_success, proportion
from flipperctl.process import entry

COUNTS = (2, 3, 5, 10, 20, 100)
"""Numbers of values in a sample [-]."""
SMALLEST = 20
"""Smallest number of recorded values that represent a distribution [-]."""
RATES = (0.5, 0.8, 0.95, 0.99)
"""Success rates [-]."""
UNEQUAL = ((0.0, 0.0), (0.02, 0.02), (0.1, 0.02), (0.1, 0.1), (0.3, 0.1))
"""Rates at which only the first policy succeeds, and only the second [-]."""

Sample = Callable[[np.random.Generator, tuple[int, int]], FloatArray]
"""Draws an array of values."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table of coverages; exit with code 2 if an argument or a file is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage")
    parser.add_argument(
        "files",
        nargs="*",
        type=Path,
        help="episodes.csv of eval --output; methods that reached fewer than "
        f"{SMALLEST} episodes of a scene are left out",
    )
    chosen = parsed(parser, arguments)
    try:
        recorded = dict(_recorded(chosen.files))
    except (OSError, UnicodeDecodeError, csv.Error, KeyError, ValueError) as error:
        parser.error(f"files: {error}; an episodes.csv that eval --output wrote is allowed")
    print(line("mean (Student's t)", [f"n={count}" for count in COUNTS]))
    distributions = _distributions() | recorded
    for name, (truth, sample) in distributions.items():
        rng = np.random.default_rng(chosen.seed)
        found = [mean_coverage(truth, sample, n, chosen.repetitions, rng) for n in COUNTS]
        print(line(name, found), flush=True)
    print(line("success rate (Wilson)", [f"n={count}" for count in COUNTS]))
    for rate in RATES:
        print(line(f"rate {rate:g}", [rate_coverage(rate, n) for n in COUNTS]))
    print(line("difference of paired rates (Tango)", [f"n={count}" for count in COUNTS]))
    for won, lost in UNEQUAL:
        name = f"first alone {won:g}, second alone {lost:g}"
        print(line(name, [paired_coverage(won, lost, n) for n in COUNTS]))
    return 0


def parsed(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of a simulation, which exits with code 2 if one is wrong."""
    parser.add_argument("--repetitions", type=int, default=5000, help="samples of each kind [5000]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the samples [0]")
    chosen = parser.parse_args(arguments)
    for name, least in (("repetitions", 1), ("seed", 0)):
        if (value := getattr(chosen, name)) < least:
            parser.error(f"--{name}: {value}; {least} or more is allowed")
    return chosen


def mean_coverage(
    truth: float, sample: Sample, count: int, repetitions: int, rng: np.random.Generator
) -> float:
    """Return the fraction of samples of ``count`` values whose interval contains the mean.

    It is NaN where there is no interval.
    """
    found = [interval(values) for values in sample(rng, (repetitions, count))]
    return sum(contains(one, truth) for one in found) / repetitions


def rate_coverage(rate: float, total: int) -> float:
    """Return the probability that the interval of a success rate contains it."""
    return math.fsum(
        _binomial(count, total, rate)
        for count in range(total + 1)
        if contains(proportion(count, total), rate)
    )


def paired_coverage(won: float, lost: float, total: int) -> float:
    """Return the probability that the interval of the difference of paired rates contains it.

    ``won`` and ``lost``: rates at which only the first policy succeeds, and only the second.
    """
    either = won + lost
    share = won / either if either else 0.5
    return math.fsum(
        _binomial(unequal, total, either) * _binomial(first, unequal, share)
        for unequal in range(total + 1)
        for first in range(unequal + 1)
        if contains(paired_success(first, unequal - first, total), won - lost)
    )


def contains(found: Interval, truth: float) -> float:
    """Return 1 if an interval contains the truth, else 0; NaN without an interval."""
    if found.low is None or found.high is None:
        return math.nan
    rounding = 1e-9  # the ends may equal the true value
    return float(found.low - rounding <= truth <= found.high + rounding)


def _binomial(count: int, total: int, rate: float) -> float:
    return math.comb(total, count) * rate**count * (1 - rate) ** (total - count)


def _distributions() -> dict[str, tuple[float, Sample]]:
    """Return distributions with their means."""
    return {
        "normal": (0.0, lambda rng, shape: rng.normal(size=shape)),
        "exponential": (1.0, lambda rng, shape: rng.exponential(size=shape)),
        "lognormal, sigma 0.5": (math.exp(0.125), lambda rng, s: rng.lognormal(0, 0.5, s)),
    }


def _recorded(files: Sequence[Path]) -> Iterator[tuple[str, tuple[float, Sample]]]:
    """Yield θ̂_R of each scene and method, and differences, as distributions with their means."""
    for key, values in _values(files).items():
        if len(values) >= SMALLEST:
            yield key, (float(np.mean(values)), _resampling(np.array(values)))


def _resampling(values: FloatArray) -> Sample:
    return lambda rng, shape: rng.choice(values, shape)


def _values(files: Sequence[Path]) -> Mapping[str, list[float]]:
    """Return θ̂_R at 100 Hz [rad], and paired differences, by scene and method."""
    played: dict[str, dict[str, dict[str, float]]] = {}
    for file in files:
        with file.open(newline="") as opened:
            for row in csv.DictReader(opened):
                if row["outcome"] == Outcome.REACHED and not is_best_known(row["controller"]):
                    scene = played.setdefault(f"{row['scene']} {row['conditions_hash']}", {})
                    variation = float(row["pitch_variation_100hz"])
                    scene.setdefault(row["controller"], {})[row["seed"]] = variation
    found = {}
    for scene_name, methods in played.items():
        for method, variations in methods.items():
            found[f"{scene_name}, {method}"] = list(variations.values())
        for one, other in combinations(methods, 2):
            pairs = methods[one].keys() & methods[other].keys()
            found[f"{scene_name}, {one} - {other}"] = [
                methods[one][seed] - methods[other][seed] for seed in sorted(pairs)
            ]
    return found


def line(name: str, cells: Sequence[float | str]) -> str:
    """Return a row of the table: a name and fractions; a dash where there is no interval."""
    texts = [
        cell if isinstance(cell, str) else "-" if math.isnan(cell) else f"{cell:.1%}"
        for cell in cells
    ]
    return f"{name:44}" + "".join(f"{text:>8}" for text in texts)


if __name__ == "__main__":
    entry.run(main)
