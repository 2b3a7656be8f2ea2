"""A figure of one episode: the robot's poses on the terrain, its pitch and flipper angles.

In: the trace of an episode. Out: a figure, with the map of a sensor that maps the ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from flipperctl.api import FloatArray, Profile, RobotGeometry, RobotState
from flipperctl.figures.figure import (
    WIDTH,
    draw_ground,
    frame,
    in_style,
    legend_above,
    scaled,
    style_axes,
)
from flipperctl.figures.render import CHASSIS, FAINT, FRONT, HEIGHTS, INK, REAR, RobotArtist
from flipperctl.rollout.trace import Trace
from flipperctl.sim.outline import outlines

_LEAST = 0.02
"""Smallest range of the colours of heights [m]."""


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
    bar.set_label("height H of each bin [m]; white: never seen", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    style_axes(axes, "", "", "ahead [m]")


_POSES = 12
"""Largest number of intervals between poses [-]."""


@in_style
def episode_figure(trace: Trace, title: str = "") -> Figure:
    """Draw poses with their times on the terrain, above pitch and flipper angles over time.

    Poses are drawn at the start, at the end and evenly in between. Along the path of the chassis'
    centre they are a little less than the robot's length apart, or a twelfth of the path if that is
    longer. The heights of very long ground are scaled up, as the axis label states. Of a sensor
    that maps the ground, the map's points are drawn as of each pose, and the heights H over time
    below.
    """
    robot, path, profile = trace.robot, trace.position, trace.profile
    reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    poses = pose_indices(path, max(1.75 * reach, length / _POSES))
    states = [trace.state(i) for i in range(len(path))]
    shown = [states[i] for i in poses]
    tops = [outlines(state, robot)[:, :, 1].max() for state in shown]
    low, high = window(path, profile, reach, max(tops))
    scale, height = scaled(low, high, 6.0)
    heights = [2.4] if trace.maps else []
    figure = Figure(figsize=(WIDTH, height + 3.9 + sum(heights)), layout="constrained")
    above, below, *lowest = figure.subplots(
        2 + len(heights), 1, height_ratios=[height, 2.6, *heights]
    )
    draw_ground(above, profile)
    above.plot(path[:, 0], path[:, 1], color=INK, linewidth=0.9, label="chassis centre")
    if trace.maps:
        points = np.concatenate([trace.maps[trace.latest(state.time)] for state in shown])
        above.plot(*points.T, ".", color=HEIGHTS, markersize=2.4, zorder=4, label="map")
    lines = above.get_lines()[1:]  # without the ground, and before the robots
    for i, (state, top) in enumerate(zip(shown, tops, strict=True)):
        RobotArtist(above, zorder=5.0 + i).show(state, robot)
        above.annotate(
            f"{state.time:.1f} s", (state.position[0], top), xytext=(0, 4), ha="center",
            textcoords="offset points", fontsize=8, color=INK, zorder=5.0 + len(shown),
        )  # fmt: skip
    frame(above, low, high, scale, title)
    legend_above(above, lines)
    for state in shown:
        below.axvline(state.time, color=FAINT, linewidth=0.8, linestyle=":")
    limit, _ = draw_angles(below, states, robot, "time [s]; dotted: the poses above")
    below.margins(x=0.02)
    below.yaxis.set_major_locator(MultipleLocator(15 if limit < 75 else 30))
    for axes in lowest:
        _draw_heights(figure, axes, trace)
        axes.set_xlim(below.get_xlim())
    return figure


def pose_indices(path: FloatArray, spacing: float) -> list[int]:
    """Return indices into a path (T, 2) [m]: first, last and those ``spacing`` apart."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    poses = max(1, int(along[-1] / spacing)) + 1
    wanted = np.linspace(0.0, along[-1], poses)
    indices = np.minimum(np.searchsorted(along, wanted - 1e-9), len(path) - 1)
    return sorted({*indices.tolist(), len(path) - 1})


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
        lines += axes.plot(time, angles, style, color=colour, linewidth=1.6, label=label)
    limit = math.degrees(max(robot.angle_limit, *(abs(state.pitch) for state in states)))
    axes.set_ylim(-1.1 * limit, 1.1 * limit)
    legend_above(axes, lines)
    style_axes(axes, "", x_label, "angle [°]")
    return limit, lines
