"""Figures of episodes: the robot's poses on the terrain, its pitch and flipper angles over time.

In: traces of episodes. Out: a figure, with the map of a sensor that maps the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, MultipleLocator

from flipperctl.api import FloatArray, Outcome, Profile, RobotGeometry, RobotState
from flipperctl.figures.figure import (
    COLUMN,
    NO_PLACES,
    WIDTH,
    Places,
    draw_ground,
    frame,
    in_style,
    legend,
    legend_above,
    look,
    panels,
    points,
    scaled,
    style_axes,
)
from flipperctl.figures.render import CHASSIS, FAINT, FRONT, HEIGHTS, INK, REAR, RobotArtist
from flipperctl.rollout.trace import Trace
from flipperctl.sim.outline import outlines

_LEAST = 0.02
"""Smallest range of the colours of heights [m]."""
_HIGHEST = 5.0
"""Largest height of all panels of poses together [in]."""
_POSES = 6
"""Largest number of poses in a panel [-]."""
_FADE = 0.75
"""How far the first pose fades, if there are many [-]."""


@in_style
def episode_figure(trace: Trace) -> Figure:
    """Draw poses with their times on the terrain, above pitch and flipper angles over time.

    If the sensor maps the ground, the map's points at the time of each pose are drawn, and the
    perceived heights over time below.
    """
    heights = [1.7] if trace.maps else []
    # Panels for the poses, the angles and, with a map, the perceived heights
    box = _window([trace])
    scale, height = scaled(*box, 4.0, WIDTH)
    figure = Figure(figsize=(WIDTH, height + 2.7 + sum(heights)), layout="constrained")
    above, below, *lowest = figure.subplots(
        2 + len(heights), 1, height_ratios=[height, 1.7, *heights]
    )
    shown = _draw_poses(above, trace, scale, box)
    # Dotted lines mark the instants of the poses above.
    states = [trace.state(i) for i in range(len(trace.time))]
    for state in shown:
        below.axvline(state.time, color=FAINT, linewidth=0.6, linestyle=":")
    limit, _ = draw_angles(below, states, trace.robot, "Time [s]")
    below.margins(x=0.02)
    below.yaxis.set_major_locator(MultipleLocator(15 if limit < 50 else 30))
    for axes in lowest:
        _draw_heights(figure, axes, trace)
        axes.set_xlim(below.get_xlim())
    figure.align_ylabels()
    _fit(figure, [above], scale)
    return figure


@in_style
def poses_figure(traces: Sequence[Trace], names: Sequence[str], *, width: float = WIDTH) -> Figure:
    """Draw each episode's poses along the ground, one below the other; earlier poses fade.

    All panels show the same part of the world. ``names``: names of the policies, above their
    panels; empty for none.
    """
    box = _window(traces)
    scale, height = scaled(*box, max(1.0, _HIGHEST / len(traces)), width)
    each = height + points(0.35 if any(names) else 0.15)
    figure = Figure(figsize=(width, len(traces) * each + points(0.35)), layout="constrained")
    below = list(figure.subplots(len(traces), 1, squeeze=False, sharex=True)[:, 0])
    for axes, trace, name in zip(below, traces, names, strict=True):
        _draw_poses(axes, trace, scale, box)
        ended = "" if trace.outcome == Outcome.REACHED else f": {trace.outcome}"
        axes.set_title(f"{name}{ended}", loc="left")
        axes.set_xlabel(axes.get_xlabel() if axes is below[-1] else "")
    _fit(figure, below, scale)
    return figure


@in_style
def series_figure(
    traces: Sequence[Trace],
    names: Sequence[str],
    *,
    places: Places = NO_PLACES,
    width: float = COLUMN,
) -> Figure:
    """Draw pitch, flippers and the height of the chassis over time, a curve for each policy.

    Of four flippers, a pale curve shows the left one.

    ``places``: see ``figure.places``. A cross ends the curve of an episode that did not reach the
    finish.
    """
    figure, axes = panels(width, 4, points(0.98))
    looks = [look(places.get(name, at), marked=False) for at, name in enumerate(names)]
    # A panel for each quantity, with a curve for each policy
    for panel, (label, values) in zip(axes, _SERIES.items(), strict=True):
        style_axes(panel, label, "", "")
        for shown, trace in zip(looks, traces, strict=True):
            far, curve = values(trace)
            if far is not None:
                panel.plot(trace.time, far, **shown, alpha=0.45)
            panel.plot(trace.time, curve, **shown)
            if trace.outcome != Outcome.REACHED:
                panel.plot(
                    trace.time[-1:], curve[-1:], "X", color=shown["color"], markersize=points(5),
                    clip_on=False, zorder=9,
                )  # fmt: skip
        if "°" in label:
            panel.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 1.5, 3, 6, 10]))
    # Time is named below the lowest panels alone.
    for panel in axes:
        place = panel.get_subplotspec()
        if place is not None and place.is_last_row():
            panel.set_xlabel("Time [s]")
    lines = [Line2D([], [], label=name, **shown) for shown, name in zip(looks, names, strict=True)]
    legend(figure, lines if len(lines) > 1 else [])
    if any(trace.flippers.size for trace in traces):
        axes[1].set_title("Pale: on the left side", loc="right")
    figure.align_ylabels()
    return figure


def _sides(trace: Trace, end: int) -> tuple[FloatArray | None, FloatArray]:
    """Return the angles of the left and the right flipper at an end [°]; of pairs, the second."""
    if trace.flippers.size:
        left, right = np.degrees(trace.flippers[:, 2 * end : 2 * end + 2]).T
        return left, right
    return None, np.degrees((trace.front, trace.rear)[end])


_SERIES: dict[str, Callable[[Trace], tuple[FloatArray | None, FloatArray]]] = {
    "Pitch [°]": lambda trace: (None, np.degrees(trace.pitch)),
    "Front flippers [°]": lambda trace: _sides(trace, 0),
    "Rear flippers [°]": lambda trace: _sides(trace, 1),
    "Chassis height [m]": lambda trace: (None, trace.position[:, 1] - trace.position[0, 1]),
}


def _shown(trace: Trace) -> list[RobotState]:
    """Return the poses that are drawn: start and end, and evenly between along the path."""
    reach = trace.robot.reach
    length = float(np.hypot(*np.diff(trace.position, axis=0).T).sum())
    indices = pose_indices(trace.position, max(0.6 * reach, length / (_POSES - 1)))
    shown: list[RobotState] = []
    for state in map(trace.state, reversed(indices)):  # a stuck robot moves and gets nowhere
        if not shown or np.linalg.norm(state.position - shown[-1].position) > 0.3 * reach:
            shown.append(state)
    return shown[::-1]


def _window(traces: Sequence[Trace]) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box that shows all poses of all traces, (x, z) in world [m]."""
    boxes = []
    for trace in traces:
        tops = [outlines(state, trace.robot)[:, :, 1].max() for state in _shown(trace)]
        boxes.append(window(trace.position, trace.profile, trace.robot.reach, max(tops)))
    lows, highs = zip(*boxes, strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _draw_poses(
    axes: Axes, trace: Trace, scale: int, box: tuple[FloatArray, FloatArray]
) -> list[RobotState]:
    """Draw the ground, the path of the chassis centre, and poses with their times; return these.

    ``box``: corners of what is shown, (x, z) in world [m].
    """
    # The ground, and the way of the chassis centre over it
    draw_ground(axes, trace.profile)
    path = axes.plot(
        *trace.position.T, color=INK, linewidth=points(0.6), label="chassis centre", zorder=15
    )
    shown = _shown(trace)
    # What the map held at the instants of the poses
    if trace.maps:
        seen = np.concatenate([trace.maps[trace.latest(state.time)] for state in shown])
        path += axes.plot(
            *seen.T, ".", color=HEIGHTS, markersize=points(1.5), zorder=4, label="map"
        )
        legend_above(axes, path)
    # Earlier poses fade, and later ones lie over them.
    for i, state in enumerate(shown):
        fade = _FADE * (1 - (i + 1) / len(shown))
        RobotArtist(axes, zorder=5.0 + i, fade=fade).show(state, trace.robot)
    frame(axes, *box, scale)
    axes.set_aspect("auto")  # see _fit
    # Times stand above all bodies, side by side, and a line leads to the middle of each pose.
    size: Any = axes.get_figure(root=True)
    inch = float((box[1] - box[0])[0]) / (size.get_figwidth() - points(0.6))  # [m]
    wide, tall = points(0.34) * inch, points(0.12) * inch / scale  # [m]
    corners = np.concatenate([outlines(state, trace.robot) for state in shown])  # (3 S, P, 2)
    along = np.linspace(0, 1, 20)[:, None, None, None]
    bodies = (corners + along * (np.roll(corners, -1, axis=1) - corners)).reshape(-1, 2)
    ordered = sorted(shown, key=lambda state: float(state.position[0]))
    places = spread([float(state.position[0]) for state in ordered], wide)
    for x, state in zip(places, ordered, strict=True):
        near = np.abs(bodies[:, 0] - x) < 0.6 * wide
        top = float(bodies[near, 1].max()) if near.any() else float(state.position[1])
        line: dict[str, Any] = {"arrowstyle": "-", "color": INK, "linewidth": points(0.5)}
        axes.annotate(
            f"{state.time:.1f} s", tuple(state.position), (x, top + 0.6 * tall), ha="center",
            va="bottom", fontsize=points(7), zorder=20,
            arrowprops=line | {"shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        axes.plot(*state.position, "o", color=INK, markersize=points(2), zorder=20)
    return shown


def spread(wanted: Sequence[float], gap: float) -> list[float]:
    """Return the places nearest to ascending wanted ones that are at least ``gap`` apart."""
    # Places without their gaps must ascend: those that do not are pooled at their mean.
    pools: list[tuple[float, int]] = []
    for at, place in enumerate(wanted):
        pool, count = place - at * gap, 1
        while pools and pools[-1][0] > pool:
            mean, members = pools.pop()
            pool, count = (mean * members + pool * count) / (members + count), members + count
        pools.append((pool, count))
    flat = [mean for mean, members in pools for _ in range(members)]
    return [mean + at * gap for at, mean in enumerate(flat)]


def _fit(figure: Figure, panels: Sequence[Axes], scale: int) -> None:
    """Extend what panels of ground show to the scale of their heights.

    They keep their places, so that panels below each other have equal widths.
    """
    for _ in range(2):  # labels of other heights have another width
        figure.draw_without_rendering()
        for axes in panels:
            box = axes.get_window_extent()
            (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
            # Whichever is too small for the scale grows, so that nothing is cut off.
            more = (right - left) * box.height / (box.width * scale) - (high - low)
            axes.set_ylim(low - max(0.0, more) / 2, high + max(0.0, more) / 2)
            wider = max(0.0, -more) * scale * box.width / box.height / 2
            axes.set_xlim(left - wider, right + wider)


def _draw_heights(figure: Figure, axes: Axes, trace: Trace) -> None:
    """Draw the perceived heights H over time; bins that were never seen are left white."""
    heights = trace.heights  # (D, N) [m]
    half = heights.shape[1] * trace.bin_width / 2
    edges = np.linspace(-half, half, heights.shape[1] + 1)
    times = [*trace.decided, trace.time[-1]]
    limit = max(_LEAST, float(np.nanmax(np.abs(heights), initial=0.0)))
    mesh = axes.pcolormesh(
        times, edges, heights.T, cmap="cividis", vmin=-limit, vmax=limit, rasterized=True
    )
    bar = figure.colorbar(mesh, ax=axes, location="bottom", fraction=0.05, aspect=70, pad=0.02)
    style_axes(bar.ax, "", "Perceived height of each bin [m]; white: never seen", "")
    bar.ax.grid(visible=False)
    style_axes(axes, "", "", "Ahead [m]")


def pose_indices(path: FloatArray, spacing: float) -> list[int]:
    """Return indices into a path (T, 2) [m], ``spacing`` apart from the first to the last."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    poses = max(1, int(along[-1] / spacing)) + 1
    wanted = np.linspace(0.0, along[-1], poses)
    nearest = {int(np.abs(along - distance).argmin()) for distance in wanted}
    return sorted({*nearest, len(path) - 1})


def window(
    path: FloatArray, profile: Profile, reach: float, top: float
) -> tuple[FloatArray, FloatArray]:
    """Return the lower left and upper right corner of the picture, (x, z) in world [m]."""
    margin = reach + 0.1
    (left, _), (right, _) = path.min(axis=0) - margin, path.max(axis=0) + margin
    inside = (profile.points[:, 0] >= left) & (profile.points[:, 0] <= right)
    ground = [profile.height(left), profile.height(right), *profile.points[inside, 1]]
    return np.array([left, min(ground) - 0.2]), np.array([right, top + 0.25])


def draw_angles(
    axes: Axes, states: Sequence[RobotState], robot: RobotGeometry, x_label: str
) -> tuple[float, list[Line2D]]:
    """Draw pitch and flippers over time; return the largest angle shown [°], and the lines."""
    time, lines = [state.time for state in states], list[Line2D]()
    for name, colour, style in (
        ("pitch", CHASSIS, "-"),
        ("front", FRONT, "--"),
        ("rear", REAR, "-."),
    ):
        angles = [math.degrees(getattr(state, name)) for state in states]
        label = name if name == "pitch" else f"{name} flippers"
        lines += axes.plot(time, angles, style, color=colour, label=label)
    limit = math.degrees(max(robot.angle_limit, *(abs(state.pitch) for state in states)))
    axes.set_ylim(-1.1 * limit, 1.1 * limit)
    legend_above(axes, lines)
    style_axes(axes, "", x_label, "Angle [°]")
    return limit, lines
