"""A map's success and pitch variation in the plane of two settings.

In: the document of ``map.json``. Out: a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

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

    Dots mark the points that were played, if others are interpolated; a line runs between points
    with a success of at least one half and below it.
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
    figure, axes = panels(width, 2, points(2.1))
    finite = variation[np.isfinite(variation)]
    limits = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    for panel, grid, name, colours, ends in (
        (axes[0], success, "success", "viridis", (0.0, 100.0)),
        (axes[1], variation, VARIATION, "viridis_r", limits),
    ):
        _panel(panel, (first, second), grid, name, colours, ends)
        panel.label_outer()
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
    if len(lines := boundary(first["values"], second["values"], success / 100)):
        edge: dict[str, Any] = {"color": INK, "linewidth": points(1.3)}
        for panel in axes:
            # The outline of an edge would lie over its neighbours.
            for look in ({"color": "white", "linewidth": points(2.8)}, edge):
                panel.add_collection(LineCollection(list(lines), capstyle="round", **look))
        handles.append(Line2D([], [], label="success 50 %", **edge))
    if np.isnan(variation).any():
        count, whole = len(mapped["cells"]), success.size
        text = f"none reached, or not played ({count} of {whole} points are)"
        text = text if count < whole else "none reached"
        handles.append(Patch(color=_EMPTY, label=text))
    legend(figure, handles)
    figure.supxlabel(axis_label(first), fontsize="medium")
    figure.supylabel(axis_label(second), fontsize="medium")
    return figure


def axis_label(axis: Mapping[str, Any]) -> str:
    """Return an axis' settings in words, and their unit."""
    names = dict.fromkeys(key.rpartition(".")[2] for key in axis["settings"])
    text = ", ".join(name.replace("_", " ") for name in names)
    unit = "" if axis["unit"] in ("", "-") else f" [{axis['unit']}]"
    return f"{text[0].upper()}{text[1:]}{unit}"


def boundary(first: Any, second: Any, success: FloatArray) -> FloatArray:
    """Return the edges of points, (K, 2, 2), across which success crosses ``BOUNDARY``.

    An edge has two ends (x, y) in the units of the axes, halfway between neighbouring points.
    ``success`` has shape (rows, columns), 0 to 1, NaN where it is unknown, at the values ``first``,
    (columns,), and ``second``, (rows,).
    """
    x, y = _edges(first), _edges(second)
    high = np.where(np.isnan(success), np.nan, success >= BOUNDARY)
    upright = [
        [(x[j + 1], y[i]), (x[j + 1], y[i + 1])]
        for i, j in np.argwhere(np.abs(np.diff(high, axis=1)) == 1)
    ]
    level = [
        [(x[j], y[i + 1]), (x[j + 1], y[i + 1])]
        for i, j in np.argwhere(np.abs(np.diff(high, axis=0)) == 1)
    ]
    return np.reshape([*upright, *level], (-1, 2, 2))


def _edges(values: Any) -> FloatArray:
    """Return the edges, (K + 1,), of points at ascending values, (K,)."""
    at = np.asarray(values, np.float64)
    if len(at) == 1:
        return np.array([at[0] - 0.5, at[0] + 0.5])
    middle = (at[1:] + at[:-1]) / 2
    return np.array([2 * at[0] - middle[0], *middle, 2 * at[-1] - middle[-1]])


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
        _edges(first["values"]), _edges(second["values"]), np.ma.masked_invalid(grid),
        cmap=colours, vmin=limits[0], vmax=limits[1], rasterized=True,
    )  # fmt: skip
    bar = panel.figure.colorbar(mesh, ax=panel)
    style_axes(bar.ax, "", "", "")
    bar.ax.grid(visible=False)
    style_axes(panel, label(name), "", "")
    panel.grid(visible=False)
