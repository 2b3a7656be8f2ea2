"""Films of episodes: several policies one above the other, one take after the other.

In: policies and the seeds of episodes, which are played once more. Out: a file. An engine that
draws itself is asked for its pictures between samples, so that the episode equals that of an
evaluation bit for bit; others are shown from the side. Equal input gives equal files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from flipperctl.api import (
    SAMPLE_PERIOD,
    DrawingWorld,
    FloatArray,
    Profile,
    RobotState,
    Transition,
    World,
)
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.errors import RequestError
from flipperctl.figures import settings
from flipperctl.figures.animation import LAST, SHOWN, Frame, check_film, write_film
from flipperctl.figures.episode import draw_angles, window
from flipperctl.figures.figure import SCREEN, draw_ground, frame, scaled, styled
from flipperctl.figures.render import FAINT, HEIGHTS, INK, RobotArtist, drawn_pixels
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.trace import instants, map_points, mapped
from flipperctl.sim.mujoco.appearance import SKY
from flipperctl.sim.outline import outlines

_DPI = 100
_HIGHEST = 5.0
"""Largest height of the ground's part of a picture [in]."""
SPEED = 3.0
"""Real time per time of a film [-]."""
_SLOWEST, _FASTEST = SAMPLE_PERIOD / SHOWN, 20.0
_COARSER = 2
"""Frames of other films to one of a GIF in 3-D, whose pictures are the largest [-]."""
_WIDTH, _ALONE, _STACKED = 720, 405, 288
"""Width of the pictures of an engine, and their height for one policy and for several [pixels]."""
_STRIP, _TEXT, _MARGIN = 32, 17, 10
"""Height of the strips with words, of their letters, and the space beside them [pixels]."""


class Part(NamedTuple):
    """A policy in a take."""

    name: str
    config: EnvConfig
    source: PolicySource
    seed: int
    """Seed of the episode."""


class Take(NamedTuple):
    """Policies that are shown at the same time."""

    title: str
    parts: Sequence[Part]


class Shot(NamedTuple):
    """One instant of an episode."""

    picture: NDArray[np.uint8]  # (H, W, 3)
    time: float  # [s]
    variation: float  # of the pitch, until then [rad]
    done: float  # part of the episode that is over, 0 to 1
    outcome: str = ""  # empty while the episode runs


def samples_per_frame(speed: float) -> int:
    """Return the number of samples from one frame to the next; check the ``speed`` of a film."""
    count = speed * SHOWN / SAMPLE_PERIOD
    if not (_SLOWEST <= speed <= _FASTEST and count == round(count)):
        raise RequestError(
            f"--speed {speed:g}: multiples of {_SLOWEST:g} are allowed, up to {_FASTEST:g}"
        )
    return round(count)


def film(
    path: Path,
    takes: Sequence[Take],
    *,
    speed: float = SPEED,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> None:
    """Play the episodes of the takes and write their film, completely or not at all.

    ``speed``: real time per time of the film [-]. ``report_progress`` is called with the finished
    fraction.
    """
    samples = samples_per_frame(speed)
    check_film(path)
    # The first world decides how all takes are drawn, since frames need one size.
    envs = [[FlipperEnv(config=part.config) for part in take.parts] for take in takes]
    first, part = envs[0][0], takes[0].parts[0]
    first.reset(seed=part.seed)
    if isinstance(first.drive.world.of_engine, DrawingWorld):
        coarser = _COARSER if path.suffix.lower() == ".gif" else 1
        height = _STACKED if len(takes[0].parts) > 1 else _ALONE
        clips = [
            [_drawn(*view, samples * coarser, height) for view in zip(row, take.parts, strict=True)]
            for row, take in zip(envs, takes, strict=True)
        ]
    else:
        coarser, clips = 1, _from_the_side(envs, takes, samples * SAMPLE_PERIOD)
    words = "real time" if speed == 1 else f"{speed:g} × real time"

    def frames() -> Iterator[Frame]:
        for number, (take, together) in enumerate(zip(takes, clips, strict=True)):
            pending: Frame | None = None
            # A frame waits for the next one, since the last of a take is shown for longer.
            for shots in _together(together):
                if pending is not None:
                    yield pending
                rows = [_labelled(None, take.title, words, shots[0].picture.shape[1])]
                for part, shot in zip(take.parts, shots, strict=True):
                    rows.append(_labelled(shot.picture, part.name, _numbers(shot)))
                pending = np.concatenate(rows), SHOWN * coarser
                report_progress((number + min(shot.done for shot in shots)) / len(takes))
            if pending is not None:
                yield pending[0], LAST

    with settings():
        write_film(path, frames())


def _numbers(shot: Shot) -> str:
    ending = f"{shot.outcome}   " if shot.outcome else ""
    return f"{ending}{shot.time:.1f} s   pitch variation {shot.variation:.2f} rad"


def _together(clips: Sequence[Iterator[Shot]]) -> Iterator[list[Shot]]:
    """Yield a shot of each clip at a time; a clip that is over keeps its last shot."""
    shots: list[Shot | None] = [next(clip, None) for clip in clips]
    running = [shot is not None for shot in shots]
    while any(running):
        yield [shot for shot in shots if shot is not None]
        for at, clip in enumerate(clips):
            following = next(clip, None)
            running[at] = following is not None
            shots[at] = following or shots[at]


def _labelled(
    picture: NDArray[np.uint8] | None, left: str, right: str, width: int = 0
) -> NDArray[np.uint8]:
    """Return a picture below a strip with words, or a strip as wide as given."""
    from PIL import Image, ImageDraw, ImageFont

    face = "DejaVuSans" if picture is None else "DejaVuSans-Bold"
    file = f"{matplotlib.get_data_path()}/fonts/ttf/{face}.ttf"
    strip = Image.new("RGB", (width if picture is None else picture.shape[1], _STRIP), SKY)
    draw = ImageDraw.Draw(strip)
    for text, x, anchor in ((left, _MARGIN, "lm"), (right, strip.width - _MARGIN, "rm")):
        font: Any = ImageFont.truetype(file, _TEXT)
        draw.text((x, _STRIP // 2), text, INK, font, anchor)
    whole = np.asarray(strip)
    return whole if picture is None else np.concatenate([whole, picture])


class _Shots(Observer):
    """Takes pictures of a world that draws itself, at the start and at equal intervals."""

    def __init__(self, every: int, height: int) -> None:
        self.every: int = every
        self._height = height
        self._pitch = np.empty(0)
        self._variation = 0.0
        self.taken: list[tuple[NDArray[np.uint8], float, float]] = []

    def moved(self, time: float, poses: FloatArray) -> None:
        """Add the changes of the pitch."""
        pitches = np.concatenate([self._pitch, poses[:, 2]])
        self._variation += float(np.abs(np.diff(pitches)).sum())
        self._pitch = pitches[-1:]

    def stopped(self, world: World) -> None:
        """Take a picture."""
        assert isinstance(world, DrawingWorld)
        picture = world.draw(_WIDTH, self._height)
        self.taken.append((picture, world.state().time, self._variation))


def _drawn(env: FlipperEnv, part: Part, every: int, height: int) -> Iterator[Shot]:
    """Yield the shots of an episode as it is played, drawn by its engine."""
    shots, begin, done = _Shots(every, height), None, 0.0
    for decision in decisions(env, part.source.build(part.config), part.seed, observers=[shots]):
        x, finish = env.state.position[0], env.drive.termination.finish
        begin = decision.transition.before.position[0] if begin is None else begin
        outcome = str(decision.ending["outcome"]) if decision.ending else ""
        if outcome:
            # The outcome is shown on the picture of the instant at which the episode ends.
            shots.stopped(env.drive.world)
        last = len(shots.taken) - 1
        for at, taken in enumerate(shots.taken):
            yield Shot(*taken, done, outcome if at == last else "")
        done = 1.0 if outcome else min(1.0, max(0.0, (x - begin) / (finish - begin)))
        shots.taken.clear()


def _from_the_side(
    envs: Sequence[Sequence[FlipperEnv]], takes: Sequence[Take], period: float
) -> list[list[Iterator[Shot]]]:
    """Play all episodes; return their clips, which show equal parts of the world in each take."""
    # All episodes are played first, since the pictures of a take share one part of the world.
    views: list[list[tuple[SideView, FloatArray, FloatArray, str]]] = []
    for row, take in zip(envs, takes, strict=True):
        views.append([])
        for env, part in zip(row, take.parts, strict=True):
            policy = part.source.build(part.config)
            episode = [d.transition for d in decisions(env, policy, part.seed)]
            view = SideView(episode, env.profile, part.config.robot.track_speed, period)
            times = [t.before.time + t.sample_period * np.arange(len(t.path)) for t in episode]
            pitches = np.concatenate([t.path[:, 2] for t in episode])
            outcome = str(episode[-1].outcome)
            views[-1].append((view, np.concatenate(times), pitches, outcome))
    # One box for the parts of a take, and one height for all of the film
    boxes = []
    for row_of_views in views:
        corners = np.array([view.box for view, *_ in row_of_views])  # (P, 2, 2) [m]
        boxes.append(np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)]))
    height = max(map(SideView.height, boxes))
    angles = all(len(take.parts) == 1 for take in takes)
    for row_of_views, box in zip(views, boxes, strict=True):
        for view, *_ in row_of_views:
            view.prepare(box, height, angles=angles)
    return [[_seen(*shown) for shown in row_of_views] for row_of_views in views]


def _seen(view: SideView, times: FloatArray, pitches: FloatArray, outcome: str) -> Iterator[Shot]:
    """Yield the shots of an episode from the side; ``times`` and ``pitches``: every sample."""
    variations = np.concatenate([[0.0], np.abs(np.diff(pitches)).cumsum()])
    last = len(view.states) - 1
    for index, state in enumerate(view.states):
        at = int(np.searchsorted(times, state.time + 1e-6, "right")) - 1
        ending = outcome if index == last else ""
        yield Shot(view.picture(index), state.time, float(variations[at]), index / last, ending)


class SideView:
    """A figure whose moving parts alone are drawn again at each instant.

    The points of a sensor that maps the ground are drawn as of the latest decision.
    """

    def __init__(
        self, transitions: Sequence[Transition], profile: Profile, speed: float, period: float
    ) -> None:
        """``speed``: speed of the belts [m/s]; ``period``: time between two instants [s]."""
        self._robot, self._speed, self._profile = transitions[0].robot, speed, profile
        self.states: list[RobotState] = list(instants(transitions, period))
        self._maps = _maps(transitions, self.states)

    @property
    def box(self) -> FloatArray:
        """Lower left and upper right corner of what the episode needs, (2, 2) in world [m]."""
        robot = self._robot
        top = max(float(outlines(state, robot)[:, :, 1].max()) for state in self.states)
        path = np.array([state.position for state in self.states])  # (T, 2) [m]
        return np.stack(window(path, self._profile, robot.reach, top))

    @staticmethod
    def height(box: FloatArray) -> float:
        """Return the height of the ground's part of a picture of a box [in]."""
        return scaled(box[0], box[1], _HIGHEST, SCREEN)[1]

    def prepare(self, box: FloatArray, height: float, *, angles: bool) -> None:
        """Draw what does not move; ``angles``: whether they are drawn below the ground."""
        with styled("screen"):
            self._prepare(box, height, angles)

    def _prepare(self, box: FloatArray, height: float, angles: bool) -> None:
        # The ground above, and below it the angles
        heights = [height, 1.3] if angles else [height]
        size = SCREEN, height + (2.2 if angles else 0.7)
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        above, *lower = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        draw_ground(above, self._profile)
        self._artist = RobotArtist(above)
        (self._points,) = above.plot(
            [], [], ".", color=HEIGHTS, markersize=2.4, zorder=4, scalex=False, scaley=False
        )
        frame(above, box[0], box[1], scaled(box[0], box[1], _HIGHEST, SCREEN)[0])
        self._moving = [self._points, *self._artist.artists]
        self._lines: list[tuple[Any, FloatArray]] = []
        self._now: list[Any] = []
        for below in lower:
            limit, lines = draw_angles(below, self.states, self._robot, "time [s]")
            below.set_xlim(self.states[0].time, self.states[-1].time)
            below.set_yticks([-round(limit), 0, round(limit)])
            self._lines = [(line, np.array(line.get_data())) for line in lines]
            self._now = [below.axvline(0.0, color=FAINT, linewidth=0.8)]
            self._moving += [*self._now, *lines]
        # What moves is drawn over a background that is drawn once.
        for artist in self._moving:
            artist.set_animated(True)  # excludes it from the background
        self._canvas = cast("Any", FigureCanvasAgg(figure))
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return the picture of an instant, (H, W, 3)."""
        state = self.states[index]
        self._artist.show(state, self._robot, self._speed * state.time)
        if self._maps:
            self._points.set_data(*self._maps[index].T)
        for line in self._now:
            line.set_xdata([state.time, state.time])
        for line, angles in self._lines:  # (2, T)
            line.set_data(*angles[:, : index + 1])
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            artist.draw(self._canvas.get_renderer())
        return drawn_pixels(self._canvas)


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
