"""A headless Chromium of this machine, which draws 3-D scenes in software."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ARGUMENTS = (
    "--no-sandbox",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
)
DRAWING = "--use-angle=swiftshader", "--enable-unsafe-swiftshader"
"""Arguments of a browser that draws 3-D scenes; others compute half as much."""


def installed() -> str | None:
    """Return the browser's program; None without one."""
    names = "chromium", "chromium-browser", "google-chrome"
    return next(filter(None, map(shutil.which, names)), None)


def launch(play: Any, *, draws: bool = True) -> Any:
    """Return a browser of a ``playwright`` that runs; an error says what to install.

    ``draws``: whether it draws 3-D scenes.
    """
    program = installed()
    if program is None:
        raise SystemExit("no Chromium on this machine; on Debian: apt install chromium")
    arguments = [*ARGUMENTS, *(DRAWING if draws else ("--disable-gpu",))]
    return play.chromium.launch(executable_path=program, args=arguments)


@contextmanager
def chromium(*, draws: bool = True) -> Iterator[Any]:
    """Run the browser until the block ends; ``draws``: whether it draws 3-D scenes."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = launch(play, draws=draws)
        try:
            yield browser
        finally:
            browser.close()
