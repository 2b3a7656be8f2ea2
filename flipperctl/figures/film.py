"""Films as GIFs, and pictures of instants: an episode, or what a robot perceived on its recording.

In: the transitions of an episode, the profile and the robot; or a replay of perception. Out: an
animated GIF, three times as fast as real time, or one picture. Equal input gives equal files. A
replay shows the latest scan, with the ground that the estimator made of it, and below how certain
each height is. An engine that draws its own pictures is asked for them between samples, so that the
episode equals that of an evaluation bit for bit.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from flipperctl.api import (
    SAMPLE_PERIOD,
    DrawingWorld,
    FloatArray,
    Profile,
    RobotGeometry,
    RobotState,
    Transition,
    World,
)
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.errors import RequestError
from flipperctl.figures.episode import draw_angles, window
from flipperctl.figures.figure import (
    PICTURE,
    SCREEN,
    draw_ground,
    frame,
    save,
    scaled,
    style_axes,
    styled,
)
from flipperctl.figures.render import FAINT, HEIGHTS, INK, RobotArtist
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import play
from flipperctl.rollout.trace import instants, map_points, mapped
from flipperctl.sim.outline import outlines

if TYPE_CHECKING:
    from PIL.Image import Image

    from flipperctl.ros.perceiving import Instant, Replay


_MARK = b"film by flipperctl"
"""Comment in each film, by which an earlier one is recognised."""
FILM = OutputKind("a film", (".gif",), re.compile(_MARK))
_PERIOD = 0.12
"""Simulated time between two frames [s]; players treat less than 0.02 s a frame as 0.1 s."""
_RATE = 3
"""Real time per time of a film [-]."""
_LAST = 1.5
"""Time that the last frame is shown before the film begins again [s]."""
_COLOURS = 63
"""Number of colours, without the one that marks unchanged pixels [-]."""
_DPI = 100
SIZE = 640, 480
"""Width and height of the pictures of an engine that draws itself [pixels]."""
_EVERY = 20
"""Samples between two of these: 5 per second [-]."""


def save_film(
    path: Path,
    transitions: Sequence[Transition],
    profile: Profile,
    robot: RobotGeometry,
    title: str = "",
    report_progress: Callable[[float], None] = lambda fraction: None,
    *,
    speed: float,
) -> None:
    """Write the film of an episode, completely or not at all.

    The points of a sensor that maps the ground are drawn as of the latest decision.

    ``report_progress`` is called with the fraction of frames drawn so far; ``speed``: that of the
    belts in the film [m/s].
    """
    check_output(path, FILM)
    states = list(instants(transitions, _PERIOD))
    with styled("screen"):
        picture = _Picture(states, profile, robot, title, speed, _maps(transitions, states))
    frames = _drawn(picture, enumerate(states), len(states), report_progress)
    _write_frames(path, frames, [_PERIOD / _RATE] * (len(frames) - 1) + [_LAST])


def _drawn(
    picture: _Picture | _PerceivedPicture,
    shown: Iterable[Any],
    count: int,
    report_progress: Callable[[float], None],
) -> list[Image]:
    """Return a frame of each instant, with the palette of the first one."""
    from PIL import Image

    frames: list[Image.Image] = []
    for instant in shown:
        canvas = picture.show(instant)
        frame = Image.fromarray(np.array(canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3])
        palette = {"palette": frames[0]} if frames else {"colors": _COLOURS}
        frames.append(frame.quantize(dither=Image.Dither.NONE, **palette))
        report_progress(len(frames) / count)
    return frames


def _write_frames(path: Path, frames: Sequence[Image], shown: Sequence[float]) -> None:
    """Write frames as a GIF that repeats; ``shown``: time of each frame [s]."""
    durations = [round(1000 * time) for time in shown]  # [ms]
    buffer = io.BytesIO()
    more = {"append_images": frames[1:], "duration": durations, "comment": _MARK}
    frames[0].save(buffer, "GIF", save_all=True, loop=0, **more)
    write_bytes(path, buffer.getvalue())


def _maps(transitions: Sequence[Transition], states: Sequence[RobotState]) -> list[FloatArray]:
    """Return the map at each state, (P, 2) in world [m]; nothing unless the sensor has one."""
    perceived = mapped(transitions)
    if not perceived:
        return []
    places = [t.before.position for t in transitions]
    maps = [map_points(p, place) for p, place in zip(perceived, places, strict=True)]
    starts = [t.before.time for t in transitions]
    latest = np.searchsorted(starts, [state.time + 1e-9 for state in states], "right") - 1
    return [maps[i] for i in latest.tolist()]


class _Picture:
    """One figure of which each frame redraws only the moving parts."""

    def __init__(
        self,
        states: Sequence[RobotState],
        profile: Profile,
        robot: RobotGeometry,
        title: str,
        speed: float,
        maps: Sequence[FloatArray],
    ) -> None:
        self._robot, self._speed, self._maps = robot, speed, maps
        reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius
        top = max(float(outlines(state, robot)[:, :, 1].max()) for state in states)
        path = np.array([state.position for state in states])  # (T, 2) [m]
        low, high = window(path, profile, reach, top)
        scale, height = scaled(low, high, 5.0, SCREEN)
        figure = Figure(figsize=(SCREEN, height + 2.6), dpi=_DPI, layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=[height, 1.3])
        draw_ground(above, profile)
        self._artist = RobotArtist(above)
        (self._points,) = above.plot(
            [], [], ".", color=HEIGHTS, markersize=2.4, zorder=4, scalex=False, scaley=False
        )
        frame(above, low, high, scale, f"{title}, {_RATE} × real time".lstrip(", "))
        self._clock = above.annotate(
            " 0.0 s", (1.0, 1.0), xycoords="axes fraction", xytext=(0, 5), ha="right",
            textcoords="offset points", fontsize=11, color=INK, family="DejaVu Sans Mono",
        )  # fmt: skip
        limit, lines = draw_angles(below, states, robot, "time [s]")
        below.set_xlim(states[0].time, states[-1].time)
        below.set_yticks([-round(limit), 0, round(limit)])
        self._lines = [(line, np.array(line.get_data())) for line in lines]
        self._now = below.axvline(0.0, color=FAINT, linewidth=0.8)
        self._moving = [self._points, *self._artist.artists, self._clock, self._now, *lines]
        for artist in self._moving:
            artist.set_animated(True)  # excludes it from the background
        self._canvas = cast("Any", FigureCanvasAgg(figure))
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def show(self, numbered: tuple[int, RobotState]) -> Any:
        """Return the canvas with a state, of which the index is given."""
        index, state = numbered
        self._artist.show(state, self._robot, self._speed * state.time)
        if self._maps:
            self._points.set_data(*self._maps[index].T)
        self._clock.set_text(f"{state.time:4.1f} s")
        self._now.set_xdata([state.time, state.time])
        for line, angles in self._lines:  # (2, T)
            line.set_data(*angles[:, : index + 1])
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            artist.draw(self._canvas.get_renderer())
        return self._canvas


def film(config: EvalConfig, source: PolicySource, seed: int, path: Path) -> None:
    """Play the episode with this ``seed`` and write the film that its engine draws."""
    check_output(path, FILM)
    shots = Shots(config.sim.plugin_name)
    play(FlipperEnv(config=config), source.build(config), seed, observers=[shots])
    from PIL.Image import fromarray

    pictures = [fromarray(picture) for picture in shots.pictures]
    _write_frames(path, pictures, [_EVERY * SAMPLE_PERIOD] * len(pictures))


class Shots(Observer):
    """Take pictures of a world that can draw itself, at the start and at equal intervals."""

    every = _EVERY

    def __init__(self, engine: str) -> None:
        """``engine``: its registered name, for errors."""
        self._engine = engine
        self.pictures: list[NDArray[np.uint8]] = []
        """(H, W, 3) each."""

    def stopped(self, world: World) -> None:
        """Take a picture."""
        if not isinstance(world, DrawingWorld):
            raise RequestError(f"sim={self._engine} draws no pictures for a film")
        self.pictures.append(world.draw(*SIZE))


_FACE = 0.02
"""Lowest vertical face that is drawn as one [m]."""
_DEEP, _HIGH = -0.35, 0.4
"""Range of the heights that is always shown [m]."""
_WORST = 100.0
"""Deviation at which a bar ends [mm]."""
_FACES, _FILLED = "#CC3311", "#EE9922"


def check_perceived(path: Path | None, at: float | None) -> None:
    """Check, before the replay, that a film or a picture can be written to ``path``.

    A picture needs ``--at`` and a film has none; both need a path.
    """
    if path is None:
        raise RequestError("--at: a picture needs --output FILE.png")
    suffix = path.suffix.lower()
    if suffix in FILM.suffixes and at is not None:
        raise RequestError(f"--at {at:g}: a film shows all instants; a picture ends in .png")
    if suffix in PICTURE.suffixes and at is None:
        raise RequestError(f"--output {path}: a picture needs --at SECONDS; a film ends in .gif")
    check_output(path, FILM if at is None else PICTURE)


def draw_perceived(
    path: Path,
    replay: Replay,
    robot: RobotGeometry,
    at: float | None = None,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> None:
    """Write the film of a replay, or the picture of its instant nearest to ``at`` [s]."""
    check_perceived(path, at)
    times = [one.time for one in replay.instants]
    apart = max(np.diff(times).tolist(), default=0.0)
    if at is not None and not times[0] - apart <= at <= times[-1] + apart:
        allowed = f"{times[0]:g} to {times[-1]:g} s of the recording are allowed"
        raise RequestError(f"--at {at:g}: {allowed}")
    with styled("screen"):
        picture = _PerceivedPicture(replay, robot, f", {_RATE} × real time" if at is None else "")
    if at is not None:
        picture.show(min(replay.instants, key=lambda one: abs(one.time - at)))
        save(picture.figure, path)
        return
    frames = _drawn(picture, replay.instants, len(times), report_progress)
    shown = [pause / _RATE for pause in np.diff(times).tolist()]
    _write_frames(path, frames, [*shown, _LAST])


def faces(points: FloatArray, filled: NDArray[np.bool_]) -> list[FloatArray]:
    """Return the vertical faces among ``points`` (P, 2) of the ground, bottom and top (2, 2) [m].

    They are seen points of equal x; ``filled`` (P,) points were not seen.
    """
    seen = points[~filled]
    stacked = [(x, seen[seen[:, 0] == x, 1]) for x in np.unique(seen[:, 0])]
    return [np.array([[x, z.min()], [x, z.max()]]) for x, z in stacked if np.ptp(z) >= _FACE]


class _PerceivedPicture:
    """One figure; each instant changes what is drawn in it."""

    def __init__(self, replay: Replay, robot: RobotGeometry, rate: str) -> None:
        self._robot, self._width, self._strip = robot, replay.bin_width, replay.half_width
        first = replay.instants[0].ground
        assert first.deviation is not None  # of a map
        count = len(first.deviation)
        self._edges = (np.arange(count) - count / 2) * replay.bin_width
        reach = count * replay.bin_width / 2
        tip = robot.hinge_offset + robot.flipper_axle + robot.track_radius
        points = np.concatenate([one.ground.points[:, 1] for one in replay.instants])
        low = min(_DEEP, max(float(points.min()), -1.5)) - 0.05
        high = max(_HIGH, min(float(points.max()), 1.5)) + 0.05
        half = max(reach, tip) + 0.15
        tall = (SCREEN - 1.0) * (high - low) / (2 * half)
        whole = 2 * tall + 3.0  # [in]
        self.figure = Figure(figsize=(SCREEN, whole), dpi=80)
        left, wide = 0.7 / SCREEN, (SCREEN - 0.9) / SCREEN

        def place(bottom: float, height: float) -> Axes:
            box = (left, bottom / whole, wide, height / whole)
            axes = self.figure.add_axes(box)
            axes.set_xlim(-half, half)
            return axes

        bars = place(0.5, 0.7)
        ground, scan = place(1.6, tall), place(2.4 + tall, tall)
        (self._beside,) = scan.plot([], [], ".", color="#BBBBBB", markersize=1.5)
        (self._cloud,) = scan.plot([], [], ".", color=INK, markersize=2)
        style_axes(scan, f"scan{rate}; grey: beside the robot's strip", "", "z [m]")
        self._ground(ground)
        self._sigmas = bars.bar(
            self._edges, 0.0, self._width * 0.9, align="edge", color=HEIGHTS, linewidth=0
        )
        bars.set_ylim(0, _WORST)
        x_label = f"ahead of the chassis centre [m]; red: σ above {_WORST:g} mm"
        style_axes(bars, "", x_label, "σ [mm]")
        for axes in (scan, ground):
            axes.set_ylim(low, high)
        self._robots = [RobotArtist(axes) for axes in (scan, ground)]
        self._clock = scan.text(
            1.0, 1.02, "", transform=scan.transAxes, ha="right", fontsize=10, color=INK
        )
        self._canvas: Any = FigureCanvasAgg(self.figure)

    def _ground(self, axes: Axes) -> None:
        self._bins = [
            axes.add_patch(Rectangle((x, 0), self._width, 0, color=HEIGHTS, alpha=0.3, linewidth=0))
            for x in self._edges
        ]
        self._unseen = [
            axes.add_patch(Rectangle((x, -5), self._width, 10, color="#EEEEEE", zorder=0))
            for x in self._edges
        ]
        (self._means,) = axes.plot([], [], color=HEIGHTS, linewidth=2, label="heights ± 2σ")
        (self._known,) = axes.plot([], [], ".", color="#99AACC", markersize=1.2, label="map")
        (self._seen,) = axes.plot([], [], ".", color=INK, markersize=3, label="ground")
        (self._filled,) = axes.plot(
            [], [], "o", color=_FILLED, markersize=3, markerfacecolor="none", label="filled"
        )
        self._faces = LineCollection([], colors=_FACES, linewidths=2.5, zorder=6)
        axes.add_collection(self._faces, autolim=False)
        (entry,) = axes.plot([], [], color=_FACES, linewidth=2.5, label="face")
        lines = [self._means, self._known, self._seen, self._filled, entry]
        style_axes(axes, "estimate; shaded: never seen", "", "z [m]")
        axes.legend(
            handles=lines, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False,
            ncols=len(lines), borderaxespad=0.0,
        )  # fmt: skip

    def show(self, instant: Instant) -> Any:
        """Return the canvas with an instant."""
        angles, ground = instant.angles, instant.ground
        state = RobotState(
            np.zeros(2), angles.pitch, angles.front, angles.rear, np.zeros(2), 0.0, instant.time
        )
        for artist in self._robots:
            artist.show(state, self._robot)
        strip = np.abs(instant.cloud[:, 1]) <= self._strip
        self._cloud.set_data(instant.cloud[strip, 0], instant.cloud[strip, 2])
        self._beside.set_data(instant.cloud[~strip, 0], instant.cloud[~strip, 2])
        self._known.set_data(instant.known[:, 0], instant.known[:, 2])
        none = np.zeros(len(ground.points), np.bool_)
        filled = none if ground.filled is None else ground.filled
        self._seen.set_data(*ground.points[~filled].T)
        self._filled.set_data(*ground.points[filled].T)
        self._faces.set_segments(faces(ground.points, filled))
        assert ground.heights is not None  # of a map
        means = ground.heights[: len(self._edges)]
        self._show_bins(means, ground.seen, ground.deviation)
        held = f", held: {instant.held}" if instant.held else ""
        self._clock.set_text(f"{instant.time:5.1f} s{held}")
        self._canvas.draw()
        return self._canvas

    def _show_bins(self, heights: FloatArray, seen: Any, deviation: FloatArray | None) -> None:
        count = len(heights)
        known = np.ones(count, np.bool_) if seen is None else seen
        sigmas = np.zeros(count) if deviation is None else deviation
        x = np.stack([self._edges, self._edges + self._width, np.full(count, math.nan)], axis=1)
        z = np.where(known, heights, math.nan)
        self._means.set_data(x.ravel(), np.repeat(z, 3))
        for i in range(count):
            sigma = float(sigmas[i]) if known[i] else 0.0
            self._bins[i].set(y=float(heights[i]) - 2 * sigma, height=4 * sigma)
            self._unseen[i].set_visible(not known[i])
            self._sigmas[i].set_height(min(_WORST, 1000 * sigma))
            self._sigmas[i].set_color(_FACES if 1000 * sigma > _WORST else HEIGHTS)
