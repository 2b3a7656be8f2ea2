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
    NO_PLACES,
    SUCCESS,
    Places,
    in_style,
    label,
    legend,
    look,
    note,
    points,
    style_axes,
)
from flipperctl.figures.render import FAINT, INK
from flipperctl.text.messages import percent

Row = Mapping[str, Any]
"""Keys ``method`` and ``scene``, and by the name of each metric a mean with its interval: a mapping
with ``mean``, ``low`` and ``high``, whose ends may be None; or None where there is no value."""
_BANDS, _BARS = 2, 6
"""Largest number of profiles with bands; number of bars of each, where there are more [-]."""
_PALE = 0.85  # opacity of the cells of a heat table [-]
_MOST = 6
"""Largest number of scenes beside each other in a heat table [-]."""
_NARROWEST = 1.45
"""Width of a panel from which its label fits below it [in] on paper."""
_ROW = 0.15
"""Height of a method's line in a figure [in] on paper."""


@in_style
def intervals_figure(
    rows: Sequence[Row],
    metrics: Sequence[str],
    *,
    places: Places = NO_PLACES,
    width: float = COLUMN,
) -> Figure:
    """Draw the mean of each method and its 95 % interval, a panel for each metric.

    With one scene, methods stand below each other by name; with several, scenes do, and a legend
    names the methods. ``places``: see ``figure.places``.
    """
    looks = _looks(rows, places)
    figure, axes = _lined(rows, len(metrics), width)
    for panel, metric in zip(axes, metrics, strict=True):
        _estimates(panel, rows, looks, metric)
        style_axes(panel, "", label(metric), "")
        panel.grid(visible=False, axis="y")
        if metric == SUCCESS:
            panel.set_xlim(-5, 105)
    _name(figure, axes, rows, looks)
    return figure


@in_style
def differences_figure(
    rows: Sequence[Row],
    metric: str,
    against: str,
    price: float,
    *,
    places: Places = NO_PLACES,
    width: float = COLUMN,
) -> Figure:
    """Draw the differences of methods to ``against`` on the same episodes; less is better.

    ``price``: what a failed episode counts in means and intervals, in the metric's unit.

    Rows have the mean with its interval under ``metric``; under ``episodes`` the differences of
    single episodes, (E,), which are drawn as dots; and under ``failed`` who failed in each: 1 the
    method alone, -1 ``against`` alone, 0 neither or both. Failures of one alone are crosses at the
    ends of the axis, whatever a failure counts as.
    """
    looks = _looks(rows, places)
    figure, (axes,) = _lined(rows, 1, width)
    # The range of the dots and the intervals
    ends = [row[metric][key] for row in rows for key in ("low", "mean", "high")]
    spreads = [np.asarray(row["episodes"])[np.asarray(row["failed"]) == 0] for row in rows]
    inside = np.concatenate([[0.0], *spreads, [end for end in ends if end is not None]])
    margin = 0.12 * (float(np.ptp(inside)) or 1.0)
    edges = {-1: float(inside.min()) - margin, 1: float(inside.max()) + margin}
    # Single episodes as dots around the line of their method, failures as crosses at the ends
    crossed = False
    for height, row in _placed(rows):
        spread, failed = np.array(row["episodes"], np.float64), np.asarray(row["failed"])
        # Dots of equal differences stay apart; the same in every picture.
        shift = np.random.default_rng(len(spread)).uniform(-0.22, 0.22, len(spread))
        for side, marker in ((0, "."), (-1, "x"), (1, "x")):
            drawn = failed == side
            crossed |= bool(side and drawn.any())
            axes.plot(
                spread[drawn] if side == 0 else np.full(drawn.sum(), edges[side]),
                height + shift[drawn] / _count(rows), marker, alpha=0.55,
                color=looks[row["method"]]["color"], markersize=points(4.0 if side else 3.5),
                markeredgewidth=points(0.8) if side else 0,
            )  # fmt: skip
    axes.set_xlim(edges[-1] - margin / 2, edges[1] + margin / 2)
    # Means with their intervals, and the side of zero that is better
    axes.axvline(0.0, color=INK, linewidth=points(0.7))
    _estimates(axes, rows, looks, metric)
    words = f"← better than {against}; a failure counts {price:.4g}"
    axes.text(
        0.0, 1.0, words, transform=axes.transAxes, va="bottom", color=FAINT,
        fontsize=matplotlib.rcParams["legend.fontsize"],
    )  # fmt: skip
    name, _, unit = label(metric).rpartition(" [")
    style_axes(axes, "", f"Difference in {name[0].lower()}{name[1:]} to {against} [{unit}", "")
    axes.grid(visible=False, axis="y")
    crosses = []
    if crossed:
        figure.set_figheight(figure.get_figheight() + points(0.3))
        words = f"failed: right the method alone, left {against} alone"
        crosses = [Line2D([], [], label=words, linestyle="none", marker="x", color=FAINT)]
    _name(figure, [axes], rows, looks, crosses)
    return figure


@in_style
def heat_figure(rows: Sequence[Row], metric: str, *, width: float = COLUMN) -> Figure:
    """Draw a table of methods and scenes whose cells are coloured by their mean.

    Colours go from the least to the largest mean of each scene, since scenes are rough or smooth by
    themselves; those of success, from 0 to 100 %. A cell also tells the success, under
    ``success``, where it is below 100 %. Many scenes stand below each other.
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
            partly[at] = row[SUCCESS]["mean"]
    # Cells in the colours of their means
    tall = 0.32 if partly else 0.22
    figure = Figure(figsize=(width, points(tall * len(methods) + 0.9)), layout="constrained")
    axes = figure.subplots()
    colours = matplotlib.colormaps["viridis" if metric == SUCCESS else "viridis_r"]
    shades = table / 100
    if metric != SUCCESS:  # within each scene
        along = 0 if lines == "method" else 1
        least, most = (
            np.array(end(np.nan_to_num(table, nan=filled), axis=along, keepdims=True))
            for end, filled in ((np.min, np.inf), (np.max, -np.inf))
        )
        with np.errstate(invalid="ignore"):
            shades = (table - least) / np.where(most > least, most - least, 1.0)
    mesh = axes.imshow(
        np.ma.masked_invalid(shades), cmap=colours, aspect="auto", vmin=0, vmax=1, alpha=_PALE
    )
    # Numbers in the cells, white on dark colours
    for (i, j), value in np.ndenumerate(table):
        number = "–" if np.isnan(value) else f"{value:.3g}" if metric == SUCCESS else f"{value:.2f}"
        texts = [number, *([percent(partly[i, j])] if (i, j) in partly else [])]
        shade = np.dot(mesh.to_rgba(shades[i, j])[:3], (0.3, 0.6, 0.1)) * _PALE + 1 - _PALE
        dark = np.isfinite(value) and shade < 0.5
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
    bar.set_ticks([0, 1], labels=["0", "100"] if metric == SUCCESS else ["least", "largest"])
    words = label(metric) + ("" if metric == SUCCESS else ", coloured within each scene")
    bar.set_label(words)
    if partly:
        small = matplotlib.rcParams["legend.fontsize"]
        axes.set_title("Below a mean: success, if not 100 %", loc="left", fontsize=small)
    bar.ax.tick_params(labelsize=matplotlib.rcParams["xtick.labelsize"])
    return figure


@in_style
def profiles_figure(
    levels: Any,
    curves: Mapping[str, Any],
    metric: str,
    *,
    places: Places = NO_PLACES,
    width: float = COLUMN,
) -> Figure:
    """Draw performance profiles: the share of episodes whose score is at most each level.

    ``curves``: share with both ends of its band, (3, L), by method; ``levels``: (L,), in the unit
    of the metric. A curve ends at the method's success rate. The bands of more than two methods are
    bars at a few levels, which stay apart.
    """
    figure = Figure(figsize=(width, 0.62 * min(width, points(4.2))), layout="constrained")
    axes = figure.subplots()
    handles = []
    for at, (name, (share, low, high)) in enumerate(curves.items()):
        shown = look(places.get(name, at), marked=False)
        handles += axes.step(levels, 100 * share, where="post", label=name, **shown)
        if len(curves) <= _BANDS:
            axes.fill_between(
                levels, 100 * low, 100 * high, step="post", color=shown["color"], alpha=0.15,
                linewidth=0,
            )  # fmt: skip
            continue
        # Bars beside each other, at the middle of equal parts of the axis
        bars = (np.arange(_BARS) + (at + 0.5) / len(curves)) / _BARS * (len(levels) - 1)
        k = bars.round().astype(int)
        axes.vlines(
            levels[k], 100 * low[k], 100 * high[k], color=shown["color"], linewidth=points(0.8)
        )
    axes.set_xlim(levels[0], levels[-1])
    axes.set_ylim(-2, 102)
    style_axes(axes, "Episodes reached with at most that [%]", label(metric), "")
    legend(figure, handles)
    return figure


def _count(rows: Sequence[Row]) -> int:
    """Return the number of methods that share a line; 1 with a single scene."""
    several = len({row["scene"] for row in rows}) > 1
    return len({row["method"] for row in rows}) if several else 1


def _looks(rows: Sequence[Row], places: Places) -> dict[str, dict[str, Any]]:
    """Return colour and marker of each method."""
    methods = dict.fromkeys(row["method"] for row in rows)
    shown = {name: look(places.get(name, at)) for at, name in enumerate(methods)}
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


def _lined(rows: Sequence[Row], count: int, width: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels that share their lines, one for each method and scene.

    Panels are side by side where each has room for its label, else below each other.
    """
    lines = max(2, len(rows) + 0.7 * len({row["scene"] for row in rows}))
    longest = max(len(row["method" if _count(rows) == 1 else "scene"]) for row in rows)
    beside = (width - points(0.06 * longest)) / count >= points(_NARROWEST)
    each = points(_ROW * lines + 0.55)
    height = each * (1 if beside else count) + points(0.25 if _count(rows) > 1 else 0)
    figure = Figure(figsize=(width, height), layout="constrained")
    places = (1, count) if beside else (count, 1)
    return figure, list(figure.subplots(*places, sharey=True, squeeze=False).flat)


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
    handles: Sequence[Line2D] = (),
) -> None:
    """Name the lines at the left of the panels, and the methods of several scenes above.

    ``handles``: what the legend has besides.
    """
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
    several = methods if len(scenes) > 1 else []
    legend(figure, [*(Line2D([], [], label=name, **looks[name]) for name in several), *handles])
