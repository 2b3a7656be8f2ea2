"""Sizes of the developers' measures that are small enough for tests, and checks of every result."""

import math

import pytest

from benchmarks.settings import Benchmark, sizes
from flipperctl.config import TrainConfig

UNITS = {"m", "rad", "1/s", "s", "ms", "µs", "MiB", "-"}


def small_benchmark(**changes: object) -> Benchmark:
    """Return small sizes on steps, whose runs end by their budget and not by the clock."""
    config = TrainConfig(
        terrain="step", network="at_d3qn", seed=3, train={"decisions": 250, "workers": 2}
    )
    return Benchmark(config, sizes(small=True, changes={"limit": 3600.0, **changes}))


def check(found: dict) -> None:
    """Check raw numbers and units, and that the statistics follow from the raw numbers."""
    assert found["about"]
    for name, q in found["quantities"].items():
        assert q["unit"] in UNITS, name
        ordered = sorted(math.inf if v is None else v for v in q["values"])
        middle = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
        assert q["median"] == (pytest.approx(middle) if math.isfinite(middle) else None), name
        if q["low"] is not None:
            assert ordered[0] <= q["low"] <= (q["median"] or math.inf), name
