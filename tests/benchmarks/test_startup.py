"""Wall-clock of commands."""

import pytest

from benchmarks import startup
from flipperctl.errors import FlipperctlError
from tests.benchmarks.small import small_benchmark


def test_a_command_that_fails_is_named() -> None:
    with pytest.raises(FlipperctlError, match="flipperctl evil failed"):
        startup.measure(small_benchmark(), [("evil",)])
