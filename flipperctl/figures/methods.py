"""Figures of methods: intervals, heat tables, paired differences and performance profiles.

In: rows of plain data, a mapping for each method on each scene. Out: a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from flipperctl.figures.figure import (
    COLUMN,
    SUCCESS,
    in_style,
    label,
    legend,
    look,
    note,
    points,
    style_axes,
)
from flipperctl.figures.render import FAINT, INK

Row = Mapping[str, Any]
"""Keys ``method`` and ``scene``, and by the name of each metric a mean with its interval: a mapping
with ``mean``, ``low`` and ``high``, whose ends may be None; or None where there is no value."""
_MOST = 6
"""Largest number of scenes beside each other in a heat table [-]."""
_ROW = 0.15
"""Height of a method's line in a figure [in] on paper."""


@in_style
def intervals_figure(
    rows: Sequence[Row], metrics: Sequence[str], *, width: float = COLUMN
) -> Figure:
    """Draw the mean of each method and its 95 % interval, a panel for each metric.

    With one scene, methods stand below each other by name; with several, scenes do, and a legend
    names the methods.
    """
    looks = _looks(rows)
    figure, axes = _beside(rows, len(metrics), width)
    # Labels fold where panels are narrow.
    longest = max(len(row["method" if _count(rows) == 1 else "scene"]) for row in rows)
    narrow = (width - points(0.06 * longest)) / len(metrics) < points(1.45)
    for panel, metric in zip(axes, metrics, strict=True):
        _estimates(panel, rows, looks, metric)
        style_axes(panel, "", label(metric, folded=narrow), "")
        if narrow:
            panel.xaxis.label.set_verticalalignment("top")
            panel.xaxis.labelpad = points(2)
        panel.grid(visible=False, axis="y")
        if metric == SUCCESS:
            panel.set_xlim(-5, 105)
    _name(figure, axes, rows, looks)
    return figure


@in_style
def differences_figure(
    rows: Sequence[Row], metric: str, against: str, *, width: float = COLUMN
) -> Figure:
    """Draw the differences of methods to ``against`` on the same episodes; less is better.

    Rows have the mean with its interval under ``metric``, and under ``episodes`` the differences
    of single episodes, (E,), which are drawn as dots. The rows of ``against`` itself, without
    either, only keep the colours of the others.
    """
    looks = _looks(rows)
    rows = [row for row in rows if row["method"] != against]
    figure, (axes,) = _beside(rows, 1, width)
    # Single episodes as dots around the line of their method
    for height, row in _placed(rows):
        spread = np.asarray(row["episodes"], np.float64)
        # Dots of equal differences stay apart; the same in every picture.
        shift = np.random.default_rng(len(spread)).uniform(-0.22, 0.22, len(spread))
        axes.plot(
            spread, height + shift / _count(rows), ".", color=looks[row["method"]]["color"],
            alpha=0.35, markersize=points(3.5), markeredgewidth=0,
        )  # fmt: skip
    # Means with their intervals, and the side of zero that is better
    axes.axvline(0.0, color=INK, linewidth=points(0.7))
    _estimates(axes, rows, looks, metric)
    axes.annotate(
        "← better", (0.0, 1.0), xycoords=("data", "axes fraction"), xytext=(-3, 0), ha="right",
        va="bottom", textcoords="offset points", color=FAINT,
        fontsize=matplotlib.rcParams["legend.fontsize"],
    )  # fmt: skip
    name, _, unit = label(metric).rpartition(" [")
    style_axes(axes, "", f"Difference in {name[0].lower()}{name[1:]} to {against} [{unit}", "")
    axes.grid(visible=False, axis="y")
    _name(figure, [axes], rows, looks)
    return figure


@in_style
def heat_figure(rows: Sequence[Row], metric: str, *, width: float = COLUMN) -> Figure:
    """Draw a table of methods and scenes whose cells are coloured by their mean.

    A cell also tells the success, under ``success``, where it is below 100 %. Many scenes stand
    below each other.
    """
    # Where more scenes are compared than fit side by side, they become the lines.
    lines, columns = "method", "scene"
    if len({row["scene"] for row in rows}) > max(_MOST, len({row["method"] for row in rows})):
        lines, columns = columns, lines
    methods = list(dict.fromkeys(row[lines] for row in rows))
    scenes = list(dict.fromkeys(row[columns] for row in rows))
    # Means, and success where it is partial
    factor = 100.0 if metric == SUCCESS else 1.0
    table = np.full((len(methods), len(scenes)), np.nan)
    partly: dict[tuple[int, int], float] = {}
    for row in rows:
        at = methods.index(row[lines]), scenes.index(row[columns])
        if row[metric] is not None:
            table[at] = factor * row[metric]["mean"]
        if metric != SUCCESS and row[SUCCESS]["mean"] < 1:
            partly[at] = 100 * row[SUCCESS]["mean"]
    # Cells in the colours of their means
    tall = 0.32 if partly else 0.22
    figure = Figure(figsize=(width, points(tall * len(methods) + 0.9)), layout="constrained")
    axes = figure.subplots()
    colours = matplotlib.colormaps["viridis" if metric == SUCCESS else "viridis_r"]
    mesh = axes.imshow(np.ma.masked_invalid(table), cmap=colours, aspect="auto")
    if metric == SUCCESS:
        mesh.set_clim(0, 100)
    # Numbers in the cells, white on dark colours
    for (i, j), value in np.ndenumerate(table):
        number = "–" if np.isnan(value) else f"{value:.0f}" if metric == SUCCESS else f"{value:.2f}"
        texts = [number, *([f"{partly[i, j]:.0f} %"] if (i, j) in partly else [])]
        dark = np.isfinite(value) and np.dot(mesh.to_rgba(value)[:3], (0.3, 0.6, 0.1)) < 0.5
        axes.text(
            j, i, "\n".join(texts), ha="center", va="center", color="white" if dark else INK,
            fontsize=matplotlib.rcParams["legend.fontsize"], linespacing=1.0,
        )  # fmt: skip
    # Names around the table, without grid and frame; many scenes have tilted names.
    style_axes(axes, "", "", "")
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_yticks(range(len(methods)), methods)
    wide = max(map(len, scenes)) * len(scenes) * points(0.07) > width - points(1.2)
    tilted: dict[str, Any] = {"rotation": 35, "ha": "right"} if wide else {}
    axes.set_xticks(range(len(scenes)), scenes, **tilted)
    bar = figure.colorbar(
        mesh,
        ax=axes,
        location="bottom",
        fraction=min(0.06, 0.6 / len(methods)),
        pad=0.03,
        aspect=40,
    )
    bar.set_label(label(metric) + ("\nbelow: success, if not 100 %" if partly else ""))
    bar.ax.tick_params(labelsize=matplotlib.rcParams["xtick.labelsize"])
    return figure


@in_style
def profiles_figure(
    levels: Any, curves: Mapping[str, Any], metric: str, *, width: float = COLUMN
) -> Figure:
    """Draw performance profiles: the share of episodes whose score is at most each level.

    ``curves``: share with both ends of its band, (3, L), by method; ``levels``: (L,), in the unit
    of the metric. A curve ends at the method's success rate.
    """
    figure = Figure(figsize=(width, 0.62 * min(width, points(4.2))), layout="constrained")
    axes = figure.subplots()
    handles = []
    for at, (name, (share, low, high)) in enumerate(curves.items()):
        shown = look(at, marked=False)
        handles += axes.step(levels, 100 * share, where="post", label=name, **shown)
        axes.fill_between(
            levels, 100 * low, 100 * high, step="post", color=shown["color"], alpha=0.15,
            linewidth=0,
        )  # fmt: skip
    axes.set_xlim(levels[0], levels[-1])
    axes.set_ylim(-2, 102)
    style_axes(axes, "", label(metric), "Episodes reached\nat or below it [%]")
    legend(figure, handles)
    return figure


def _count(rows: Sequence[Row]) -> int:
    """Return the number of methods that share a line; 1 with a single scene."""
    several = len({row["scene"] for row in rows}) > 1
    return len({row["method"] for row in rows}) if several else 1


def _looks(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return colour and marker of each method."""
    methods = dict.fromkeys(row["method"] for row in rows)
    shown = {name: look(at) for at, name in enumerate(methods)}
    return {name: {key: style[key] for key in ("color", "marker")} for name, style in shown.items()}


def _placed(rows: Sequence[Row]) -> list[tuple[float, Row]]:
    """Return the height of each row, and the row; the first on top."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    placed = []
    for row in rows:
        # The methods of a scene share its line, each a little higher or lower.
        at, scene = methods.index(row["method"]), scenes.index(row["scene"])
        inside = (at - (len(methods) - 1) / 2) / (len(methods) + 0.7)
        placed.append((-float(at) if len(scenes) == 1 else -scene - inside, row))
    return placed


def _beside(rows: Sequence[Row], count: int, width: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels that share their lines, one for each method and scene."""
    lines = max(2, len(rows) + 0.7 * len({row["scene"] for row in rows}))
    height = points(_ROW * lines + 0.55 + (0.25 if _count(rows) > 1 else 0))
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, list(figure.subplots(1, count, sharey=True, squeeze=False)[0])


def _estimates(
    axes: Axes, rows: Sequence[Row], looks: Mapping[str, Mapping[str, Any]], metric: str
) -> None:
    """Draw means with their intervals; a mean without one is hollow."""
    factor = 100.0 if metric == SUCCESS else 1.0
    for height, row in _placed(rows):
        estimate, shown = row[metric], looks[row["method"]]
        if estimate is None:
            continue
        whole = estimate["low"] is not None and estimate["high"] is not None
        if whole:
            ends = [factor * estimate["low"], factor * estimate["high"]]
            axes.plot(ends, [height, height], color=shown["color"])
        axes.plot(
            [factor * estimate["mean"]], [height], linestyle="none", **shown,
            markerfacecolor=shown["color"] if whole else "white", markersize=points(4.5),
        )  # fmt: skip
    if all(row[metric] is None for row in rows):
        note(axes, "no value")


def _name(
    figure: Figure,
    axes: Sequence[Axes],
    rows: Sequence[Row],
    looks: Mapping[str, Mapping[str, Any]],
) -> None:
    """Name the lines at the left of the first panel, and the methods of several scenes above."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    names = methods if len(scenes) == 1 else scenes
    axes[0].set_yticks([-at for at in range(len(names))], names)
    around = 0.6 if len(scenes) == 1 else 0.5
    axes[0].set_ylim(-len(names) + 1 - around, around)
    for panel in axes:
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        for between in range(1, len(names)) if len(scenes) > 1 else ():
            panel.axhline(0.5 - between, color=FAINT, linewidth=points(0.4), linestyle=":")
    if len(scenes) > 1:
        legend(figure, [Line2D([], [], label=name, **looks[name]) for name in methods])
