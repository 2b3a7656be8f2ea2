"""The table of ``flipperctl eval --map``: success in percent over two settings."""

from __future__ import annotations

from flipperctl.evaluation.capability import CapabilityMap
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines


def print_map(found: CapabilityMap) -> None:
    """Print the success of each cell; a dot marks those that are interpolated."""
    first, second = found.axes
    columns, rows = found.size
    heads = [f"{value:.3g}" for value in second.values]
    indent = max(map(len, heads))
    lines = [
        f"{found.controller} on {found.terrain}: success [%] over {first.label} (columns) and "
        f"{second.label} (rows)"
    ]
    for j in reversed(range(rows)):
        cells = "".join(_text(found, i, j) for i in range(columns))
        lines.append(f"{heads[j]:>{indent}} {cells}")
    values = [f"{value:.2g}" for value in first.values]
    lines.append(f"{'':{indent}} " + "".join(f"{value:>6}" for value in values))
    lines.append(
        f"{found.played} of {columns * rows} cells played, {found.episodes} episodes each; dots: "
        "interpolated between equal neighbours"
    )
    conditions = condition_lines([(found.terrain, found.seed, found.conditions)])
    print_lines(console(), [*lines, *conditions])


def _text(found: CapabilityMap, i: int, j: int) -> str:
    cell = found.cells.get((i, j))
    if cell is None:
        return f"{'–':>6}"
    mark = "" if cell.episodes else "·"
    return f"{mark}{100 * cell.success:.0f}".rjust(6)
