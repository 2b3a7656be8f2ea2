"""Random messages for the estimator of ``perception=lidar``: an estimate or a reason, never else.

    python -m benchmarks.estimator_fuzz [--count N] [--seed N]

Messages have odd times, numbers that are not finite or huge, wrong types and shapes, empty clouds
and clouds of chance. After each, an estimate is asked for. It must be a complete and finite one
with its certainty, or a ``PerceptionError``. It prints how often which of both came, and fails with
exit code 1 and the seed of the sequence if anything else did, a warning of numpy's included.
"""

from __future__ import annotations

import argparse
import itertools
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Measured, Robot, SensedAngles, SensedGround
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, PerceptionError, Pose, Scan
from flipperctl.process import entry
from flipperctl.sim.lidar import LidarSensor

SEQUENCE = 50
"""Messages that one estimator receives [-]."""
ODD = (math.nan, math.inf, -math.inf, 1e300, -1e18, 10**400, 0, -0.0, True, None, "1", b"", 1j)
"""Values that a broken driver may deliver."""
KINDS: dict[type[Pose | Joints | Inertial | Belts], int] = {
    Pose: 6,
    Joints: 2,
    Inertial: 3,
    Belts: 1,
}
"""Kinds of messages with their count of numbers."""


class UnexpectedResultError(Exception):
    """The estimator did something that is not allowed."""


def fuzz(count: int, seed: int) -> Counter[str]:
    """Return how often the ``count`` messages led to which result, or raise for another one."""
    results: Counter[str] = Counter()
    for begin in range(0, count, SEQUENCE):
        number = seed + begin // SEQUENCE
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                results.update(_sequence(number, min(SEQUENCE, count - begin)))
            except Exception as error:  # any other one is what this command looks for
                text = f"--seed {number}: {type(error).__name__}: {error}"
                raise UnexpectedResultError(text) from error
    return results


def _sequence(seed: int, count: int) -> Iterator[str]:
    """Yield the result of each message that a new estimator receives."""
    rng = np.random.default_rng(seed)
    poses = ["true", "belts", *(["matched"] if find_spec("small_gicp") else [])]
    bins, width = int(rng.integers(3, 20)), float(rng.uniform(0.05, 0.3))
    sensor: Any = LidarSensor
    sensor = sensor(pose=poses[rng.integers(len(poses))], bins=bins, bin_width=width)
    estimator = sensor.estimator(Robot())
    odd = float(rng.choice([0.0, 0.02, 0.3]))  # fraction of odd values in the sequence
    clock = 0.0
    for _ in range(count):
        clock += float(
            rng.choice([0.01, 0.1, 0.6, 0.0, -3.0, 1e6], p=[0.5, 0.3, 0.1, 0.05, 0.03, 0.02])
        )
        time = _value(rng, odd / 4, partial(float, clock))
        saved = estimator.save() if rng.random() < 0.05 else None
        try:
            estimator.update(Measured("device", time, _message(rng, odd)))
            ground, angles = estimator.estimate(_value(rng, odd / 4, partial(float, clock)))
            _check(ground, angles, sensor.layout.heights)
            yield "estimate" if ground.seen.any() else "estimate of unseen ground"
        except PerceptionError as error:
            yield "reason: " + "".join(c for c in str(error).split(";")[0] if not c.isdigit())
        if saved is not None:
            estimator.load(saved)


def _value(rng: np.random.Generator, odd: float, draw: Callable[[], float]) -> Any:
    return ODD[rng.integers(len(ODD))] if rng.random() < odd else draw()


def _message(rng: np.random.Generator, odd: float) -> object:
    """Return a random message."""
    kind = rng.integers(8)
    if kind < 4:
        made: Any = list(KINDS)[kind]
        scale = float(rng.choice([0.1, 1.0, 1.0, 100.0]))
        count = KINDS[made]
        numbers = [_value(rng, odd, lambda: scale * rng.standard_normal()) for _ in range(count)]
        return made(*numbers)
    if rng.random() < odd / 2:
        return Scan(ODD[rng.integers(len(ODD))])  # type: ignore[arg-type]  # malformed on purpose
    points = _cloud(rng)
    if rng.random() < odd:
        bad = rng.random(points.shape) < rng.choice([0.01, 1.0])
        points[bad] = rng.choice([math.nan, math.inf, 1e30, 1e18, -1e5], bad.sum())
    if rng.random() < odd:
        shapes = (points.T, points[:, :2], points.ravel(), points[None], points.astype(object))
        whole = np.zeros(points.shape, np.int32)
        types = (points.astype(complex), whole, points.astype(str), points > 0)
        return Scan([*shapes, *types][rng.integers(9)])
    return Scan(points)


def _cloud(rng: np.random.Generator) -> FloatArray:
    """Return points (P, 3) in frame S: none, few, all equal, a plane, or anywhere."""
    count = int(rng.choice([0, 1, 3, 50, 1500]))
    points = rng.standard_normal((count, 3)) * float(rng.choice([1e-3, 0.5, 2.0, 300.0]))
    shape = rng.integers(4)
    if shape == 0 and count:
        points[:] = points[0]
    elif shape == 1:
        points[:, int(rng.integers(3))] = 0.5
    elif shape == 2:  # level ground as the LiDAR sees it: its axis points 45° down ahead
        x, y = rng.uniform(-0.3, 1.5, count), rng.uniform(-0.5, 0.5, count)
        ahead, down = x, np.full(count, -0.5)
        points = np.column_stack([-(ahead + down), math.sqrt(2) * y, ahead - down]) / math.sqrt(2)
    return points.astype(rng.choice(["float64", "float32"]))


def _check(ground: SensedGround, angles: SensedAngles, heights: int) -> None:
    """Raise an ``AssertionError`` if something of the estimate is missing or not a number."""
    points, deviation, seen = ground.points, ground.deviation, ground.seen
    assert points.ndim == 2, "points"
    assert np.isfinite(points).all(), "points"
    assert (np.diff(points[:, 0]) >= 0).all(), "order of the points"
    assert ground.heights is not None, "heights"
    assert ground.heights.shape == (heights,), "heights"
    assert np.isfinite(ground.heights).all(), "heights"
    assert ground.filled is not None, "filled"
    assert ground.filled.shape == (len(points),), "filled"
    assert seen is not None, "seen"
    assert deviation is not None, "deviation"
    assert (deviation > 0).all(), "deviation"
    assert np.array_equal(np.isfinite(deviation), seen), "deviation of unseen bins"
    assert all(map(math.isfinite, (angles.front, angles.rear, angles.pitch))), "angles"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the results; exit with code 1 after an unexpected one, 2 if an argument is wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimator_fuzz",
        description="Give random messages to the estimator of perception=lidar.",
    )
    parser.add_argument("--count", type=int, default=100_000, help="messages [100000]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first sequence [0]")
    chosen = parser.parse_args(arguments)
    if chosen.count < 1 or chosen.seed < 0:
        parser.error("--count must be 1 or more, --seed 0 or more")
    try:
        results = fuzz(chosen.count, chosen.seed)
    except UnexpectedResultError as error:
        print(error)
        return 1
    for text, times in itertools.islice(results.most_common(), 40):
        print(f"{times:8d}  {text}")
    return 0


if __name__ == "__main__":
    entry.run(main)
