"""Browsers of the tests of live pages: one ``playwright`` at a time can run in a process."""

from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks import browser


@pytest.fixture(scope="module")
def play() -> Iterator[Any]:
    """Yield the ``playwright`` that launches browsers."""
    if browser.installed() is None:
        pytest.skip("no Chromium is installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def chromium(play: Any) -> Iterator[Any]:
    """Yield a browser that draws no 3-D scenes."""
    opened = browser.launch(play, draws=False)
    yield opened
    opened.close()
