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


_CROWDED = r"""() => {
  const names = "button, input, canvas, img, output, dt, dd, td, th, h1, h2, h3, label, span, p, li, a, b, text";
  const problems = [], label = (e) => `${e.tagName.toLowerCase()} ${e.id} "${e.textContent.trim().slice(0, 40)}"`;
  const boxes = [...document.querySelectorAll(names)].filter((e) => {
    if (!e.checkVisibility({ opacityProperty: true, visibilityProperty: true })) return false;
    const box = e.getBoundingClientRect();
    const text = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    return box.width && box.height && (text || e.matches("button, input, canvas, img")) && !e.closest("dialog:not([open])");
  });
  for (const e of boxes) {
    const box = e.getBoundingClientRect();
    if (box.left < -1 || box.right > innerWidth + 1) problems.push("cut: " + label(e));
    const style = getComputedStyle(e);
    if (style.overflowX !== "visible" && style.display !== "inline" && e.scrollWidth > e.clientWidth + 1 && !e.matches("input"))
      problems.push("cut inside: " + label(e));
  }
  for (const e of boxes) for (const node of e.matches("pre, pre *") ? [] : e.childNodes) {
    if (node.nodeType !== 3) continue;
    for (const word of node.data.matchAll(/[\p{L}\d_]+/gu)) {
      const range = document.createRange();
      range.setStart(node, word.index); range.setEnd(node, word.index + word[0].length);
      if (word[0].length < 25 && new Set([...range.getClientRects()].map((r) => r.top)).size > 1)
        problems.push(`broken within ${word[0]}: ${label(e)}`);
    }
  }
  boxes.forEach((a, i) => boxes.slice(i + 1).forEach((b) => {
    if (a.contains(b) || b.contains(a) || a.matches("canvas, img") || b.matches("canvas, img")) return;
    const p = a.getBoundingClientRect(), q = b.getBoundingClientRect();
    const w = Math.min(p.right, q.right) - Math.max(p.left, q.left), h = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (w > 2 && h > 3) problems.push(`over each other: ${label(a)} and ${label(b)}`);
  }));
  return problems;
}"""  # noqa: E501


def crowded(tab: Any) -> list[str]:
    """Return what is cut at the sides of a page, lies over something else, or breaks in a word."""
    problems: list[str] = tab.evaluate(_CROWDED)
    return problems
