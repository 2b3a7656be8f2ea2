"""The cost of finding plugins."""

import pytest

from benchmarks import discovery
from tests.bench.small import check
from tests.benchmarks.small import small_benchmark


def test_loading_is_compared_with_importing_the_same_modules() -> None:
    found = discovery.measure(small_benchmark())
    check(found)
    assert "3 modules" in found["about"]
    values = {name: q["values"] for name, q in found["quantities"].items()}
    beyond = [a - b for a, b in zip(values["load"], values["import"], strict=True)]
    assert values["load - import"] == pytest.approx(beyond)
