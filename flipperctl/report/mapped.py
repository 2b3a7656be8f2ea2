"""What a sensor that maps the ground has perceived, for pictures and films of an episode.

In: the transitions of an episode. Out: points of the map in world, and the heights over time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flipperctl.api import FloatArray, Perception, Transition
from flipperctl.report.figure import style_axes
from flipperctl.report.render import HEIGHTS

_LEAST = 0.02
"""Smallest range of the colours of heights [m]."""


def mapped(transitions: Sequence[Transition]) -> list[Perception]:
    """Return what was perceived at each decision; nothing unless the sensor maps the ground."""
    found = [t.perception for t in transitions]
    perceived = [p for p in found if p is not None and p.seen is not None]
    return perceived if len(perceived) == len(transitions) else []


def map_points(perception: Perception, position: FloatArray) -> FloatArray:
    """Return the points that were seen, without filled ones, in world, (P, 2) [m].

    ``position``: the true chassis centre (x, z) [m], so that only errors of the map itself show,
    and none of the odometry's drift, which policies do not feel.
    """
    points = perception.points if perception.filled is None else _seen(perception)
    return points + position


def _seen(perception: Perception) -> FloatArray:
    assert perception.filled is not None
    return np.asarray(perception.points[~perception.filled])


def draw_points(axes: Axes, perceived: Sequence[tuple[Perception, FloatArray]]) -> None:
    """Draw the map at several decisions, each with the true position of the chassis centre."""
    points = np.concatenate([map_points(p, position) for p, position in perceived])
    axes.plot(
        points[:, 0], points[:, 1], ".", color=HEIGHTS, markersize=2.4, zorder=4,
        label="map",
    )  # fmt: skip


def draw_heights(
    figure: Figure, axes: Axes, perceived: Sequence[Perception], times: Sequence[float]
) -> None:
    """Draw the perceived heights H over time; bins that were never seen are left white.

    ``times``: those of the perceptions, and that of the end, (T + 1,) [s].
    """
    layout = perceived[0].layout
    heights = np.array([p.observation[: layout.bins] for p in perceived], np.float64)  # (T, N) [m]
    heights[~np.array([p.seen for p in perceived], np.bool_)] = np.nan
    half = layout.bins * layout.bin_width / 2
    edges = np.linspace(-half, half, layout.bins + 1)
    limit = max(_LEAST, float(np.nanmax(np.abs(heights), initial=0.0)))
    mesh = axes.pcolormesh(
        times, edges, heights.T, cmap="cividis", vmin=-limit, vmax=limit, rasterized=True
    )
    bar = figure.colorbar(mesh, ax=axes, location="bottom", fraction=0.05, aspect=70, pad=0.02)
    bar.set_label("height H of each bin [m]; white: never seen", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    style_axes(axes, "", "", "ahead [m]")
