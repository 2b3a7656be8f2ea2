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
_ACROSS = 6.5
"""Length of the part of the world in each picture of a contact sheet [m]."""
_TALLEST = 4.0
"""Largest height of that part; what is longer or higher is cut [m]."""
_SKY, _EARTH = 0.3, 0.35
"""Heights in such a picture above the highest point, and of the ground below the lowest [m]."""
_NAMES, _BETWEEN = 0.24, 0.08
"""Height of the names above such pictures, and the space beside them [in]."""


@in_style
def terrain_figure(
    profiles: Sequence[Profile], robot: RobotGeometry, labels: Sequence[str] | None = None
) -> Figure:
    """Draw the first profile large with the robot in front of it, and up to twelve others small.

    x and z have equal scales, but the heights of very long ground are scaled up, which the axis
    label states. The small pictures share one scale, height and base line; the figure states how
    many profiles are left out. ``labels`` replace the numbers of the profiles.
    """
    others = profiles[1 : SMALL + 1]
    # One large picture, and rows of small ones that share a scale
    large = _window(profiles[0], robot)
    box = _shared(others) if others else np.array([[0.0, 0.0], [1.0, 1.0]])
    extent = box[1] - box[0]
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
        _draw_small(axes, profile, box, name, scale)
    left_out = len(profiles) - 1 - len(others)
    if left_out:
        figure.supxlabel(f"{left_out} more samples are not shown", fontsize="small", color=FAINT)
    return figure


@in_style
def contact_sheet(profiles: Mapping[str, Profile], robot: RobotGeometry) -> Figure:
    """Draw each profile with its name, its size and the robot in front of it.

    All pictures have one scale, which a bar of one metre shows; ground that goes on past its
    picture says so.
    """
    columns, names = min(_COLUMNS, len(profiles)), list(profiles)
    across = WIDTH / _COLUMNS - _BETWEEN  # [in]
    scale = across / _ACROSS  # [in/m]
    boxes = {name: _box(profile, robot) for name, profile in profiles.items()}
    # A row is as high as its highest picture.
    rows = [names[at : at + columns] for at in range(0, len(names), columns)]
    heights = [max(float(np.ptp(boxes[name][:, 1])) for name in row) for row in rows]  # [m]
    width = columns * (across + _BETWEEN)
    figure = Figure(figsize=(width, scale * sum(heights) + _NAMES * len(rows)))
    top = figure.get_figheight()
    for row, tall in zip(rows, heights, strict=True):
        top -= _NAMES + scale * tall
        for column, name in enumerate(row):
            profile, (low, high) = profiles[name], boxes[name]
            left = column * (across + _BETWEEN) + _BETWEEN / 2
            place = np.array([left, top, across, scale * tall])  # [in]
            axes = figure.add_axes(tuple(place / np.tile(figure.get_size_inches(), 2)))
            draw_ground(axes, profile)
            _draw_robot(axes, profile, robot)
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], low[1] + tall)
            axes.set_axis_off()
            axes.set_title(name, fontsize="small", color=INK, loc="left", pad=2.0)
            axes.set_title(_size(profile), fontsize="x-small", color=INK, loc="right", pad=2.0)
            if text := _cut(profile, low, high):
                axes.text(
                    high[0] - 0.1, low[1] + 0.04, text, size="xx-small", ha="right", va="bottom"
                )
            if column == 0:
                bar, height = low[0] + 0.15, low[1] + _EARTH / 2
                mark: dict[str, Any] = {"color": INK, "linewidth": 0.8, "markersize": 3}
                axes.plot([bar, bar + 1], [height, height], "|-", **mark)
                axes.text(bar + 1.15, height, "1 m", size="xx-small", va="center_baseline")
    return figure


def _box(profile: Profile, robot: RobotGeometry) -> FloatArray:
    """Return the corners of a picture of a contact sheet, (2, 2), (x, z) in world [m]."""
    left = profile.start - _run_up(robot) - robot.reach - 0.1
    inside = profile.points[profile.points[:, 0] <= left + _ACROSS, 1]
    base = float(profile.points[0, 1])
    low, high = float(inside.min()), max(float(inside.max()), base + 2 * robot.track_radius)
    # Of ground that is too high, what is nearest to the robot
    if high - low > _TALLEST:
        low = max(low, min(base - _TALLEST / 2, high - _TALLEST))
        high = low + _TALLEST
    return np.array([[left, low - _EARTH], [left + _ACROSS, high + _SKY]])


def _cut(profile: Profile, low: FloatArray, high: FloatArray) -> str:
    """Return where ground goes on past the corners of its picture; empty if it is whole."""
    points = profile.points
    sides = {
        "→": points[-1, 0] > high[0],
        "↑": points[:, 1].max() > high[1],
        "↓": points[:, 1].min() < low[1],
    }
    arrows = "".join(arrow for arrow, goes_on in sides.items() if goes_on)
    return f"goes on {arrows}" if arrows else ""


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


def _draw_small(axes: Axes, profile: Profile, box: FloatArray, name: str, scale: int) -> None:
    draw_ground(axes, profile)
    _mark_ends(axes, profile)
    low, high = box + profile.points[0]
    frame(axes, low, high, scale)
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


def _shared(profiles: Sequence[Profile]) -> FloatArray:
    """Return the corners of all small pictures, (2, 2), (x, z) from the first point on [m]."""
    points = [profile.points - profile.points[0] for profile in profiles]
    low = np.min([part.min(axis=0) for part in points], axis=0)
    high = np.max([part.max(axis=0) for part in points], axis=0)
    margin = np.array([0.5, 0.15])
    return np.array([low - margin, high + margin])


def _margin(profile: Profile) -> float:
    """Return the factor by which long ground needs more room for dimension lines [-]."""
    return max(1.0, (profile.end - profile.start) / 12)


def _height(extent: FloatArray, width: float, scale: int) -> float:
    """Return the height [in] of a picture of the given width [in] that shows ``extent`` [m]."""
    return float(np.clip(scale * width * extent[1] / extent[0], 0.5, 5.0))
