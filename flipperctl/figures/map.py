"""A map's success and pitch variation in the plane of two settings.

In: the document of ``map.json``. Out: a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from flipperctl.api import FloatArray
from flipperctl.figures.figure import (
    COLUMN,
    VARIATION,
    in_style,
    label,
    legend,
    panels,
    points,
    style_axes,
)
from flipperctl.figures.render import INK

BOUNDARY = 0.5  # success at the boundary [-]
_EMPTY = "#E4E4E8"
"""Colour of points without a value."""


@in_style
def map_figure(mapped: Mapping[str, Any], *, width: float = COLUMN) -> Figure:
    """Draw success and pitch variation where reached; points without a value are grey.

    Dots mark the points that were played, if others are interpolated; a line follows a success of
    one half.
    """
    # The document's cells as grids; a row has one value of the second setting.
    first, second = mapped["axes"]
    shape = len(second["values"]), len(first["values"])
    success, variation = np.full((2, *shape), np.nan)
    played = []
    for cell in mapped["cells"]:
        x, y = cell[first["name"]], cell[second["name"]]
        at = second["values"].index(y), first["values"].index(x)
        success[at] = 100 * cell["success_rate"]
        if cell["pitch_variation_100hz"] is not None:
            variation[at] = cell["pitch_variation_100hz"]
        if cell["episodes"]:
            played.append((x, y))
    # Both quantities with their own colours, and dots at what was played
    figure, axes = panels(width, 2, points(1.9))
    finite = variation[np.isfinite(variation)]
    limits = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    for panel, grid, name, colours, ends in (
        (axes[0], success, "success", "viridis", (0.0, 100.0)),
        (axes[1], variation, VARIATION, "viridis_r", limits),
    ):
        _panel(panel, (first, second), grid, name, colours, ends)
        if len(played) < len(mapped["cells"]):
            panel.plot(
                *np.transpose(played), "o", color="white", markeredgecolor=INK,
                markersize=points(1.8), markeredgewidth=points(0.4),
            )  # fmt: skip
    # The legend names only what the panels show.
    handles: list[Any] = []
    if len(played) < len(mapped["cells"]):
        handles.append(
            Line2D([], [], color="white", markeredgecolor=INK, marker="o", ls="", label="played")
        )
    if lines := boundary(first["values"], second["values"], success / 100):
        for panel in axes:
            for line in lines:
                panel.plot(line[:, 0], line[:, 1], **_edge())
        handles.append(Line2D([], [], label="success 50 %", **_edge()))
    if np.isnan(variation).any():
        count, whole = len(mapped["cells"]), success.size
        text = f"none reached, or not played ({count} of {whole} points are)"
        text = text if count < whole else "none reached"
        handles.append(Patch(color=_EMPTY, label=text))
    legend(figure, handles)
    return figure


def axis_label(axis: Mapping[str, Any]) -> str:
    """Return an axis' settings in words, and their unit."""
    names = dict.fromkeys(key.rpartition(".")[2] for key in axis["settings"])
    text = ", ".join(name.replace("_", " ") for name in names)
    unit = "" if axis["unit"] in ("", "-") else f" [{axis['unit']}]"
    return f"{text[0].upper()}{text[1:]}{unit}"


def boundary(first: Any, second: Any, success: FloatArray) -> list[FloatArray]:
    """Return the lines (K, 2) along which success is ``BOUNDARY``, in the units of the axes.

    ``success`` has shape (rows, columns), 0 to 1, NaN where it is unknown; it is linear between
    points at the values ``first``, (columns,), and ``second``, (rows,).
    """
    if min(success.shape) < 2 or not np.nanmin(success) < BOUNDARY < np.nanmax(success):
        return []
    # Matplotlib traces the line on a figure that nobody sees.
    scratch = Figure().subplots()
    lines = scratch.contour(first, second, success, levels=[BOUNDARY])
    return [np.asarray(line, np.float64) for line in lines.allsegs[0] if len(line) > 1]


def _edge() -> dict[str, Any]:
    """Return the look of the boundary, which shows on dark and on bright colours."""
    outline = withStroke(linewidth=points(2.8), foreground=to_rgba("white", 0.9))
    return {"color": INK, "linewidth": points(1.3), "path_effects": [outline]}


def _panel(
    panel: Axes,
    axes: tuple[Mapping[str, Any], Mapping[str, Any]],
    grid: FloatArray,
    name: str,
    colours: str,
    limits: tuple[float, float],
) -> None:
    """Draw one quantity of each point in its colour, with a colour bar."""
    first, second = axes
    panel.set_facecolor(_EMPTY)
    mesh = panel.pcolormesh(
        first["values"], second["values"], np.ma.masked_invalid(grid), cmap=colours,
        vmin=limits[0], vmax=limits[1], shading="nearest", rasterized=True,
    )  # fmt: skip
    bar = panel.figure.colorbar(mesh, ax=panel)
    bar.set_label(label(name, folded=True))
    style_axes(bar.ax, "", "", label(name, folded=True))
    bar.ax.grid(visible=False)
    style_axes(panel, "", axis_label(first), axis_label(second))
    panel.grid(visible=False)
