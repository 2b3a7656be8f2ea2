"""Wall-clock of commands."""

import pytest

from benchmarks import startup
from flipperctl.errors import FlipperctlError
from tests.bench.small import check, check_ratio
from tests.benchmarks.small import small_benchmark


def test_each_command_is_compared_with_pythons_own_start() -> None:
    found = startup.measure(
        small_benchmark(commands=2), [("--version",), ("eval", "--help"), ("x",)]
    )
    check(found)
    names = [startup.PYTHON, "flipperctl --version", "flipperctl eval --help"]
    assert list(found["quantities"]) == names
    for name in names[1:]:
        check_ratio(found, f"{name} / {startup.PYTHON}", name, startup.PYTHON)


def test_a_command_that_fails_is_named() -> None:
    with pytest.raises(FlipperctlError, match="flipperctl evil failed"):
        startup.measure(small_benchmark(), [("evil",)])
