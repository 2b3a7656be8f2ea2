"""Random clouds with points that no ray measured, read beside the same clouds without them.

    python -m tests.long.clouds --count 500 --seed 1

A case is a floor with a step, of random density, noise and format. Rays without return (0 0 0, NaN,
infinite, or all at the place of a sensor), holes in the floor and something overhead are added; the
profile must stay the same within the noise, and what was left out must be said. Every violation is
printed; the exit code is 1 if there is one.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from flipperctl import plugins
from flipperctl.config import resolver
from tests.plugins.test_cloud_files import save

LENGTH, STEP, CEILING = 3.0, 0.2, 2.5  # [m]
TOLERANCE = 0.03
"""Largest difference of heights away from the step [m]."""


def case(rng: np.random.Generator, file: Path) -> Iterator[str]:
    """Write and read one cloud; yield what is wrong."""
    count = int(rng.integers(6_000, 20_000))
    x, y = rng.uniform((-0.1, -0.1), (LENGTH + 0.1, 0.1), (count, 2)).T
    step = rng.uniform(1.0, 2.0)
    floor = np.column_stack([x, y, np.where(x > step, STEP, 0.0)])
    floor[:, 2] += rng.normal(0.0, rng.choice([0.0, 0.004]), count)
    begin = rng.choice([-0.1, rng.uniform(0.3, 0.8), rng.uniform(2.2, 2.6), LENGTH - 0.08])
    hole = (x > begin) & (x < begin + rng.uniform(0.05, 0.16))
    ceiling = np.column_stack(
        [*rng.uniform((-0.1, -0.1), (LENGTH + 0.1, 0.1), (4_000, 2)).T, np.full(4_000, CEILING)]
    )[: int(rng.choice([0, 60, 4_000]))]
    moved = np.append(rng.uniform(-0.3, 0.3, 2), rng.uniform(-1.0, 1.0)) * rng.integers(0, 2)
    pile = np.full((int(rng.integers(200, 2_000)), 3), rng.choice([0.0, 0.0, np.nan, np.inf]))
    points = np.vstack([floor[~hole], ceiling, pile]) + moved
    save(file, points[rng.permutation(len(points))])
    settings = {
        "name": "profile_file",
        "path": str(file),
        "start": tuple(moved[:2].tolist()),
        "end": (float(moved[0]) + LENGTH, float(moved[1])),
        "largest_gap": 0.25,
    }
    terrain = resolver.create("terrain", settings, "terrain")
    try:
        profile = terrain.generate(np.random.default_rng(0)).points
    except ValueError as error:
        yield str(error)
        return
    true = np.where(profile[:, 0] > step, STEP, 0.0)
    away = np.abs(profile[:, 0] - step) > 0.05
    if (off := np.abs(profile[:, 1] - true)[away].max()) > TOLERANCE:
        yield f"heights are {off:.2f} m off"
    said = sum("points lie exactly at" in notice for notice in terrain.notices())
    if said != np.isfinite(pile).all():
        yield f"{len(pile)} points at {pile[0] + moved}: {said} remarks"


def run(count: int, seed: int) -> Iterator[str]:
    """Yield the violations of ``count`` cases."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            file = Path(folder) / f"cloud.{rng.choice(['xyz', 'csv', 'ply', 'pcd'])}"
            yield from (f"{number} ({file.suffix}): {text}" for text in case(rng, file))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases; return 1 if there was a violation, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.clouds", description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    plugins.load()
    found = list(run(options.count, options.seed))
    print("\n".join([*found, f"{options.count} clouds, {len(found)} violations"]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
