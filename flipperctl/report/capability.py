"""A figure of a map of capability: success and θ̂_R over two settings.

In: a map. Out: a figure of two panels with the boundary at which success is 0.5, and a dot in each
cell whose episodes were played.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from flipperctl.api import FloatArray
from flipperctl.evaluation.axes import Axis
from flipperctl.evaluation.capability import CapabilityMap, Cell
from flipperctl.report.figure import WIDTH, style_axes
from flipperctl.report.render import INK

BOUNDARY = 0.5
"""Success at the boundary [-]."""
_EMPTY = "#E4E4E8"
"""Colour of cells without a value."""


def capability_figure(found: CapabilityMap) -> Figure:
    """Draw success and θ̂_R of a map side by side; cells without a value are grey.

    Raises:
        ValueError: the map has no cell.
    """
    if not found.cells:
        raise ValueError("a map needs at least one cell")
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    success = _grid(found, lambda cell: cell.success)
    swing = _grid(found, lambda cell: cell.pitch_variation)
    _panel(figure, left, found, success, "success", "viridis", (0.0, 1.0))
    finite = swing[np.isfinite(swing)]
    limits = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    _panel(figure, right, found, swing, "θ̂_R where reached [rad]", "magma_r", limits)
    for axes in (left, right):
        _draw_boundary(axes, found.axes, success)
    dots = f"{found.episodes} episodes played"
    figure.legend(
        handles=[
            Line2D([], [], color="white", markeredgecolor=INK, marker="o", ls="", label=dots),
            Line2D([], [], color="crimson", linewidth=2, label=f"success {BOUNDARY:g}"),
        ],
        loc="outside lower center", ncols=2, fontsize=8, frameon=False,
    )  # fmt: skip
    title = f"{found.controller} on {found.terrain}, conditions {found.conditions.label}"
    figure.suptitle(title, fontsize=11, color=INK)
    return figure


def boundary(axes: tuple[Axis, Axis], success: FloatArray) -> list[FloatArray]:
    """Return the lines (K, 2) along which success is ``BOUNDARY``, in the units of the axes.

    ``success`` has shape (rows, columns), NaN where it is unknown; it is linear between cells.
    """
    if min(success.shape) < 2 or not np.nanmin(success) < BOUNDARY < np.nanmax(success):
        return []
    scratch = Figure().subplots()
    first, second = axes
    lines = scratch.contour(first.values, second.values, success, levels=[BOUNDARY])
    return [np.asarray(line, np.float64) for line in lines.allsegs[0] if len(line) > 1]


def _draw_boundary(panel: Axes, axes: tuple[Axis, Axis], success: FloatArray) -> None:
    for line in boundary(axes, success):
        panel.plot(line[:, 0], line[:, 1], color="crimson", linewidth=2)


def _grid(found: CapabilityMap, value: Callable[[Cell], float | None]) -> FloatArray:
    columns, rows = found.size
    grid = np.full((rows, columns), np.nan)
    for (i, j), cell in found.cells.items():
        number = value(cell)
        grid[j, i] = np.nan if number is None else number
    return grid


def _panel(
    figure: Figure,
    panel: Axes,
    found: CapabilityMap,
    grid: FloatArray,
    title: str,
    colours: str,
    limits: tuple[float, float],
) -> None:
    """Draw one quantity of each cell in its colour, with a colour bar."""
    first, second = found.axes
    panel.set_facecolor(_EMPTY)
    masked = np.ma.masked_invalid(grid)
    mesh = panel.pcolormesh(
        _edges(first.values), _edges(second.values), masked, cmap=colours,
        vmin=limits[0], vmax=limits[1],
    )  # fmt: skip
    figure.colorbar(mesh, ax=panel)
    played = [index for index, cell in found.cells.items() if cell.episodes]
    panel.scatter(
        [first.values[i] for i, _ in played], [second.values[j] for _, j in played], s=5,
        color="white", edgecolors=INK, linewidths=0.4,
    )  # fmt: skip
    style_axes(panel, title, first.label, second.label)
    panel.grid(False)


def _edges(values: tuple[float, ...]) -> FloatArray:
    """Return the K + 1 edges of cells whose centres are K values."""
    centres = np.asarray(values, np.float64)
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])
