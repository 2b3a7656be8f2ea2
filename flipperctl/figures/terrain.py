"""Pictures and sizes of a terrain's profiles, as its episodes have them.

In: profiles and the robot's geometry. Out: a matplotlib figure, made without pyplot and its global
state, and plain data.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from flipperctl.api import FloatArray, Profile, RobotGeometry, RobotState
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.figures.figure import WIDTH, draw_ground, frame, in_style, legend_above, z_scale
from flipperctl.figures.render import FAINT, INK, RobotArtist


def sample(config: EnvConfig, seeds: Iterable[int]) -> list[tuple[Profile, dict[str, Any]]]:
    """Return the profile of the episode with each seed, and its description as plain data."""
    env = FlipperEnv(config=config)
    sampled = []
    for seed in seeds:
        env.reset(seed=seed)  # as in an episode, so that invalid profiles are found here
        row = {"seed": seed, **_describe(env.profile), "drawn": dict(env.profile.drawn)}
        sampled.append((env.profile, {**row, "points_drawn": env.points_drawn}))
    return sampled


def _describe(profile: Profile) -> dict[str, Any]:
    """Return the extent, heights and steepness of a profile, and its points in world [m]."""
    points = profile.points
    steps = np.diff(points, axis=0)  # (V - 1, 2) [m]
    faces = steps[steps[:, 0] == 0, 1]
    slopes = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))[steps[:, 0] > 0]
    return {
        "length": float(profile.end - profile.start),
        "lowest": float(points[:, 1].min()),
        "highest": float(points[:, 1].max()),
        "climb": float(points[-1, 1] - points[0, 1]),
        "largest_face": float(np.abs(faces).max(initial=0.0)),
        "steepest_slope_degrees": float(np.abs(slopes).max(initial=0.0)),
        "points": points.tolist(),
    }


SMALL = 12
"""Largest number of small pictures [-]."""
_HEADROOM = 0.35
"""Distance from the highest point to the dimension line of the length [m]."""
_MARK = 0.12
"""Height of the marks of start and finish above the ground [m]."""
_COLUMNS = 4
"""Largest number of small pictures in a row [-]."""
_CELL = 0.95
"""Height of a picture of a contact sheet, with its title [in]."""
_SHAPE, _BAND = 0.36, 0.07
"""Heights of such a picture, and of the ground below the lowest point, over its width [-]."""


@in_style
def terrain_figure(
    profiles: Sequence[Profile], robot: RobotGeometry, labels: Sequence[str] | None = None
) -> Figure:
    """Draw the first profile large with the robot in front of it, and up to twelve others small.

    x and z have equal scales, but the heights of very long ground are scaled up, which the axis
    label states. The small pictures share one scale; the figure states how many profiles are left
    out. ``labels`` replace the numbers of the profiles.
    """
    others = profiles[1 : SMALL + 1]
    # One large picture, and rows of small ones that share a scale
    large = _window(profiles[0], robot)
    extent = np.max([_extent(p) for p in others], axis=0) if others else np.ones(2)
    rows = -(-len(others) // _COLUMNS)
    columns = -(-len(others) // rows) if rows else 1  # fill the rows evenly
    scale = z_scale(large[1] - large[0])
    heights = [_height(large[1] - large[0], WIDTH - 0.6, scale)]
    small = _height(extent, WIDTH / columns - 0.2, scale)
    heights += rows * [min(small, 0.6 * heights[0]) + 0.2]
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08)
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.75), layout=layout)
    grid = figure.add_gridspec(1 + rows, columns, height_ratios=heights)
    # The numbers or labels name the profiles.
    title = labels[0] if labels and others else ""
    _draw_large(figure.add_subplot(grid[0, :]), profiles[0], robot, title, scale)
    for i, profile in enumerate(others):
        axes = figure.add_subplot(grid[1 + i // columns, i % columns])
        name = labels[i + 1] if labels else f"sample {i + 2}"
        _draw_small(axes, profile, extent, name, scale)
    left_out = len(profiles) - 1 - len(others)
    if left_out:
        figure.supxlabel(f"{left_out} more samples are not shown", fontsize="small", color=FAINT)
    return figure


@in_style
def contact_sheet(profiles: Mapping[str, Profile], robot: RobotGeometry) -> Figure:
    """Draw each profile with its name, its size and the robot in front of it.

    Each picture has a scale of its own, which a bar of one metre shows.
    """
    rows = -(-len(profiles) // _COLUMNS)
    figure = Figure(figsize=(WIDTH, _CELL * rows))
    figure.subplots_adjust(0.01, 0.01, 0.99, 1 - 0.2 / (_CELL * rows), 0.05, 0.25)
    for at, (name, profile) in enumerate(profiles.items()):
        axes = figure.add_subplot(rows, _COLUMNS, at + 1)
        draw_ground(axes, profile)
        _draw_robot(axes, profile, robot)
        # A scale of its own, with which the ground and the robot in front of it fill the picture
        low, high = profile.points.min(axis=0), profile.points.max(axis=0)
        behind = profile.start - 2 * _run_up(robot) + 0.1
        width = max(high[0] + 0.4 - behind, (high[1] - low[1] + 0.4) / (_SHAPE - _BAND))
        middle = (behind + high[0] + 0.4) / 2
        bottom, right = low[1] - _BAND * width, middle + width / 2
        axes.set_xlim(right - width, right)
        axes.set_ylim(bottom, bottom + width * _SHAPE)
        bar, height = right - 0.03 * width, (low[1] + bottom) / 2
        axes.plot([bar - 1, bar], [height, height], "|-", color=INK, linewidth=0.8, markersize=3)
        axes.text(bar - 1 - 0.02 * width, height, "1 m", size="xx-small", ha="right", va="center")
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(name, fontsize="small", color=INK, loc="left", pad=2.0)
        axes.set_title(_size(profile), fontsize="x-small", color=INK, loc="right", pad=2.0)
    return figure


def _draw_robot(axes: Axes, profile: Profile, robot: RobotGeometry) -> None:
    """Draw the robot on the level ground in front of the first edge."""
    stand = np.array([profile.start - _run_up(robot), profile.points[0, 1] + robot.track_radius])
    RobotArtist(axes).show(RobotState(stand, 0.0, 0.0, 0.0, np.zeros(2), 0.0, 0.0), robot)


def _draw_large(axes: Axes, profile: Profile, robot: RobotGeometry, title: str, scale: int) -> None:
    draw_ground(axes, profile)
    _draw_robot(axes, profile, robot)
    _mark_ends(axes, profile)
    marks = [line for line in axes.get_lines() if line.get_label() in ("start", "finish")]
    (left, bottom), (right, top) = profile.points.min(axis=0), profile.points.max(axis=0)
    # Dimension lines above and to the right of the ground
    if right > left:
        above = top + _HEADROOM
        for x, z in (profile.points[0], profile.points[-1]):
            axes.plot([x, x], [z, above], ":", color=FAINT, linewidth=0.8)
        _dimension(axes, (left, above), (right, above), f"length {right - left:.2f} m")
    if top > bottom:
        outside = right + 0.65 * _margin(profile)
        _dimension(axes, (outside, bottom), (outside, top), f"height {top - bottom:.2f} m")
    frame(axes, *_window(profile, robot), scale, title)
    if marks:
        legend_above(axes, marks)


def _draw_small(axes: Axes, profile: Profile, extent: FloatArray, name: str, scale: int) -> None:
    draw_ground(axes, profile)
    _mark_ends(axes, profile)
    points = profile.points
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    frame(axes, middle - extent / 2, middle + extent / 2, scale)
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes.spines[:].set_color("#C8C8CC")
    axes.set_title(f"{name}: {_size(profile)}", fontsize="small")


def _size(profile: Profile) -> str:
    length, height = np.ptp(profile.points, axis=0)
    return f"{length:.2f} × {height:.2f} m" if length > 0 else f"{height:.2f} m high"


def _mark_ends(axes: Axes, profile: Profile) -> None:
    """Mark where episodes start and finish on the ground, if it says so itself."""
    ends = (
        ("start", profile.run_up, profile.start, -1, ">"),
        ("finish", profile.run_out, profile.end, 1, "|"),
    )
    for name, distance, edge, direction, marker in ends:
        if distance is not None:
            x = edge + direction * distance
            height = profile.height(x) + _MARK
            axes.plot([x], [height], marker, color=INK, markersize=7, linestyle="none", label=name)


def _dimension(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    """Draw a dimension line between two points (x, z) in world [m], up or to the right."""
    bar = {"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "color": INK, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start, end, arrowprops=bar)
    axes.annotate(
        text, ((start[0] + end[0]) / 2, end[1]), xytext=(0, 4), textcoords="offset points",
        ha="center", va="bottom", color=INK,
    )  # fmt: skip


def _run_up(robot: RobotGeometry) -> float:
    """Return the distance between the drawn robot and the first edge [m]."""
    return max(1.0, robot.reach + 0.2)


def _window(profile: Profile, robot: RobotGeometry) -> tuple[FloatArray, FloatArray]:
    """Return the lower left and upper right corner of the large picture, (x, z) in world [m]."""
    low, high = profile.points.min(axis=0), profile.points.max(axis=0)
    before = 2 * _run_up(robot)
    return low - np.array([before, 0.25]), high + np.array(
        [1.3 * _margin(profile), _HEADROOM + 0.3]
    )


def _extent(profile: Profile) -> FloatArray:
    """Return width and height of the part of the world in a small picture, (2,) [m]."""
    return np.asarray(np.ptp(profile.points, axis=0) + np.array([1.0, 0.3]))


def _margin(profile: Profile) -> float:
    """Return the factor by which long ground needs more room for dimension lines [-]."""
    return max(1.0, (profile.end - profile.start) / 12)


def _height(extent: FloatArray, width: float, scale: int) -> float:
    """Return the height [in] of a picture of the given width [in] that shows ``extent`` [m]."""
    return float(np.clip(scale * width * extent[1] / extent[0], 0.5, 5.0))
