"""A browser that the tests of live pages share."""

from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks import browser


@pytest.fixture(scope="package")
def chromium() -> Iterator[Any]:
    """Yield a headless Chromium without 3-D scenes, a ``playwright`` one."""
    if browser.installed() is None:
        pytest.skip("no Chromium is installed")
    with browser.chromium(draws=False) as opened:
        yield opened
