"""The table of ``flipperctl eval --map``: success in percent over two settings."""

from __future__ import annotations

from collections.abc import Sequence

from flipperctl.evaluation.capability import CapabilityMap
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines

_DIGITS = 6
"""Digits that the values of an axis are rounded to [-]."""


def print_map(found: CapabilityMap) -> None:
    """Print the success of each cell; a dot marks those that are interpolated."""
    first, second = found.axes
    columns, rows = found.size
    heads, below = _heads(second.values), _heads(first.values)
    indent, width = max(map(len, heads)), max(6, 1 + max(map(len, below)))
    lines = [
        f"{found.controller} on {found.terrain}: success [%] over {first.label} (columns) and "
        f"{second.label} (rows)"
    ]
    for j in reversed(range(rows)):
        cells = "".join(f"{_text(found, i, j):>{width}}" for i in range(columns))
        lines.append(f"{heads[j]:>{indent}} {cells}")
    lines.append(f"{'':{indent}} " + "".join(f"{value:>{width}}" for value in below))
    lines.append(
        f"{found.played} of {columns * rows} cells played, {found.episodes} episodes each; dots: "
        "interpolated between equal neighbours"
    )
    varied = [*first.keys, *second.keys]
    conditions = condition_lines([(found.terrain, found.seed, found.conditions)], varied)
    print_lines(console(), [*lines, *conditions])


def _heads(values: Sequence[float]) -> list[str]:
    """Return the values with the fewest digits, two or more, that tell them apart."""
    for digits in range(2, _DIGITS):
        heads = [f"{value:.{digits}g}" for value in values]
        if len(set(heads)) == len(heads):
            return heads
    return [f"{value:.{_DIGITS}g}" for value in values]


def _text(found: CapabilityMap, i: int, j: int) -> str:
    cell = found.cells.get((i, j))
    if cell is None:
        return "–"
    mark = "" if cell.episodes else "·"
    return f"{mark}{100 * cell.success:.0f}"
