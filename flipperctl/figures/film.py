"""A film of one episode: the robot on the ground, and its angles over time, as a GIF.

In: the transitions of an episode in order, the profile and the robot. Out: an animated GIF, three
times as fast as real time. Equal episodes give equal files. An engine that draws its own pictures
is asked for them between samples, so that the episode equals that of an evaluation bit for bit.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
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
from flipperctl.figures.episode import draw_angles, map_points, mapped, window
from flipperctl.figures.figure import WIDTH, draw_ground, frame, scaled
from flipperctl.figures.render import FAINT, HEIGHTS, INK, RobotArtist
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import play
from flipperctl.sim.outline import outlines

if TYPE_CHECKING:
    from PIL.Image import Image


def instants(transitions: Sequence[Transition], period: float) -> Iterator[RobotState]:
    """Yield the robot's state at the start, every ``period`` [s], and at the end.

    Velocities are those at the start of the decision, since poses have none. Of a decision without
    poses, only its start is known.

    Raises:
        ValueError: there are no transitions.
    """
    if not transitions:
        raise ValueError("an episode has at least one transition")
    due = transitions[0].before.time
    for t in transitions:
        if not len(t.path):
            yield t.before
            due = t.after.time
        for index, (x, z, pitch) in enumerate(t.path[:-1].tolist()):
            time = t.before.time + index * t.sample_period
            if time < due - t.sample_period / 2:
                continue
            front, rear = t.flippers[index].tolist()
            due += period
            place = np.array([x, z])
            yield replace(t.before, position=place, pitch=pitch, front=front, rear=rear, time=time)
    yield transitions[-1].after


def samples(transitions: Sequence[Transition]) -> list[RobotState]:
    """Return every state whose pose is known, at which θ̂_R at 100 Hz is measured."""
    return list(instants(transitions, transitions[0].sample_period))


_MARK = b"film by flipperctl"
"""Comment in each film, by which an earlier one is recognised."""
FILM = OutputKind("a film", (".gif",), re.compile(_MARK))
_PERIOD = 0.12
"""Simulated time between two frames [s]."""
_SHOWN = 0.04
"""Time that a frame is shown [s]; players treat less than 0.02 s as 0.1 s."""
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

    Raises:
        OutputError: ``path`` cannot be the path of a film, see ``check_output``.
        ValueError: there are no transitions.
        WriteError: writing failed half way.
    """
    check_output(path, FILM)
    states = list(instants(transitions, _PERIOD))
    picture = _Picture(states, profile, robot, title, speed, _maps(transitions, states))
    frames: list[Image] = []
    for index, state in enumerate(states):
        colours = frames[0] if frames else None
        frames.append(picture.draw(index, state, colours))
        report_progress((index + 1) / len(states))
    write_frames(path, frames, [_SHOWN] * (len(frames) - 1) + [_LAST])


def quantized(canvas: Any, colours: Image | None) -> Image:
    """Return what a canvas of Agg shows, with the palette of ``colours`` or else its own."""
    from PIL import Image

    picture = Image.fromarray(np.array(canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3])
    if colours is None:
        return picture.quantize(_COLOURS, dither=Image.Dither.NONE)
    return picture.quantize(palette=colours, dither=Image.Dither.NONE)


def write_frames(path: Path, frames: Sequence[Image], shown: Sequence[float]) -> None:
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
        scale, height = scaled(low, high, 5.0)
        figure = Figure(figsize=(WIDTH, height + 2.6), dpi=_DPI, layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=[height, 1.3])
        draw_ground(above, profile)
        self._artist = RobotArtist(above)
        (self._points,) = above.plot(
            [], [], ".", color=HEIGHTS, markersize=2.4, zorder=4, scalex=False, scaley=False
        )
        rate = round(_PERIOD / _SHOWN)
        frame(above, low, high, scale, f"{title}, {rate} × real time".lstrip(", "))
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

    def draw(self, index: int, state: RobotState, colours: Image | None) -> Image:
        """Return the frame of ``state``, with the palette of ``colours`` or else its own."""
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
        return quantized(self._canvas, colours)


def film(config: EvalConfig, source: PolicySource, seed: int, path: Path) -> None:
    """Play the episode with this ``seed`` and write its film.

    Raises:
        OutputError: ``path`` cannot be the path of a film.
        RequestError: the engine draws no pictures, or the machine cannot.
        FlipperctlError: the policy failed, or the file cannot be written.
    """
    check_output(path, FILM)
    shots = Shots(config.sim.plugin_name)
    play(FlipperEnv(config=config), source.build(config), seed, observers=[shots])
    from PIL.Image import fromarray

    pictures = [fromarray(picture) for picture in shots.pictures]
    write_frames(path, pictures, [_EVERY * SAMPLE_PERIOD] * len(pictures))


class Shots(Observer):
    """Take pictures of a world that can draw itself, at the start and at equal intervals."""

    every = _EVERY

    def __init__(self, engine: str) -> None:
        """``engine``: its registered name, for errors."""
        self._engine = engine
        self.pictures: list[NDArray[np.uint8]] = []
        """(H, W, 3) each."""

    def stopped(self, world: World) -> None:
        """Take a picture.

        Raises:
            RequestError: the engine draws no pictures, or the machine cannot.
        """
        if not isinstance(world, DrawingWorld):
            raise RequestError(f"sim={self._engine} draws no pictures for a film")
        self.pictures.append(world.draw(*SIZE))
