"""Sizes of the developers' measures that are small enough for tests."""

from benchmarks.settings import SUITE, Benchmark
from flipperctl.bench.settings import Bench
from tests.bench.small import small_bench


def small_benchmark(**changes: object) -> Benchmark:
    """Return small sizes on steps, whose runs end by their budget and not by the clock."""
    settings = SUITE.settings(small=True, changes={"limit": 3600.0, **changes})
    return Bench(small_bench().config, settings)
