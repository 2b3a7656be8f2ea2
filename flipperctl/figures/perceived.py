"""What a robot perceived on its recording: a film of it, or a picture of one instant.

In: a replay of perception. Out: a file that shows the latest scan, the estimated ground, and below
them the certainty of each height. A film is three times as fast as real time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from flipperctl.api import FloatArray, RobotGeometry, RobotState
from flipperctl.errors import RequestError
from flipperctl.figures import settings
from flipperctl.figures.animation import FILM, LAST, Frame, check_film, write_film
from flipperctl.figures.figure import PICTURE, SCREEN, save, style_axes, styled
from flipperctl.figures.render import HEIGHTS, INK, RobotArtist, drawn_pixels
from flipperctl.text.files import check_output

if TYPE_CHECKING:
    from flipperctl.ros.perceiving import Instant, Replay

_RATE = 3
"""Real time per time of a film [-]."""
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
    if at is None:
        check_film(path)
    else:
        check_output(path, PICTURE)


def draw_perceived(
    path: Path,
    replay: Replay,
    robot: RobotGeometry,
    at: float | None = None,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> None:
    """Write the film of a replay, or the picture of its instant nearest to ``at`` [s]."""
    check_perceived(path, at)
    times = [instant.time for instant in replay.instants]
    # An instant counts as recorded up to the longest pause beyond both ends.
    apart = max(np.diff(times).tolist(), default=0.0)
    if at is not None and not times[0] - apart <= at <= times[-1] + apart:
        allowed = f"{times[0]:g} to {times[-1]:g} s of the recording are allowed"
        raise RequestError(f"--at {at:g}: {allowed}")
    with styled("screen"):
        picture = _PerceivedPicture(replay, robot, f", {_RATE} × real time" if at is None else "")
    if at is not None:
        with settings():
            picture.show(min(replay.instants, key=lambda instant: abs(instant.time - at)))
        save(picture.figure, path)
        return
    # In a film, an instant is shown until the next one.
    pauses = [*(pause / _RATE for pause in np.diff(times).tolist()), LAST]

    def frames() -> Iterator[Frame]:
        for index, (instant, shown) in enumerate(zip(replay.instants, pauses, strict=True)):
            yield picture.show(instant), shown
            report_progress((index + 1) / len(times))

    with settings():
        write_film(path, frames())


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
        # All of the recording fits into the picture, but outliers do not stretch it.
        first = replay.instants[0].ground
        assert first.deviation is not None  # of a map
        count = len(first.deviation)
        self._edges = (np.arange(count) - count / 2) * replay.bin_width
        reach = count * replay.bin_width / 2
        points = np.concatenate([instant.ground.points[:, 1] for instant in replay.instants])
        low = min(_DEEP, max(float(points.min()), -1.5)) - 0.05
        high = max(_HIGH, min(float(points.max()), 1.5)) + 0.05
        half = max(reach, robot.reach) + 0.15
        # Equal scales for x and z: the scan above the ground, and the bars below both
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
        # The robot in both pictures, and the time
        self._robots = [RobotArtist(axes) for axes in (scan, ground)]
        self._clock = scan.text(
            1.0, 1.02, "", transform=scan.transAxes, ha="right", fontsize=10, color=INK
        )
        self._canvas: Any = FigureCanvasAgg(self.figure)

    def _ground(self, axes: Axes) -> None:
        # A bar for the height of each bin with its deviation, and grey where nothing was seen
        self._bins = [
            axes.add_patch(Rectangle((x, 0), self._width, 0, color=HEIGHTS, alpha=0.3, linewidth=0))
            for x in self._edges
        ]
        self._unseen = [
            axes.add_patch(Rectangle((x, -5), self._width, 10, color="#EEEEEE", zorder=0))
            for x in self._edges
        ]
        # The estimate as lines and points
        (self._means,) = axes.plot([], [], color=HEIGHTS, linewidth=2, label="heights ± 2σ")
        (self._known,) = axes.plot([], [], ".", color="#99AACC", markersize=1.2, label="map")
        (self._seen,) = axes.plot([], [], ".", color=INK, markersize=3, label="ground")
        (self._filled,) = axes.plot(
            [], [], "o", color=_FILLED, markersize=3, markerfacecolor="none", label="filled"
        )
        self._faces = LineCollection([], colors=_FACES, linewidths=2.5, zorder=6)
        axes.add_collection(self._faces, autolim=False)
        # A collection gets no entry in the legend, so that an empty line stands for it.
        (entry,) = axes.plot([], [], color=_FACES, linewidth=2.5, label="face")
        lines = [self._means, self._known, self._seen, self._filled, entry]
        style_axes(axes, "estimate; shaded: never seen", "", "z [m]")
        axes.legend(
            handles=lines, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False,
            ncols=len(lines), borderaxespad=0.0,
        )  # fmt: skip

    def show(self, instant: Instant) -> NDArray[np.uint8]:
        """Return the picture of an instant, (H, W, 3)."""
        angles, ground = instant.angles, instant.ground
        # The robot stands at the origin of frame L, in its measured posture.
        state = RobotState(
            np.zeros(2), angles.pitch, angles.front, angles.rear, np.zeros(2), 0.0, instant.time
        )
        for artist in self._robots:
            artist.show(state, self._robot)
        # Points of the scan outside the strip of the robot's width are no part of the ground.
        strip = np.abs(instant.cloud[:, 1]) <= self._strip
        self._cloud.set_data(instant.cloud[strip, 0], instant.cloud[strip, 2])
        self._beside.set_data(instant.cloud[~strip, 0], instant.cloud[~strip, 2])
        # The map, and the ground that follows from it; filled points were not seen.
        self._known.set_data(instant.known[:, 0], instant.known[:, 2])
        none = np.zeros(len(ground.points), np.bool_)
        filled = none if ground.filled is None else ground.filled
        self._seen.set_data(*ground.points[~filled].T)
        self._filled.set_data(*ground.points[filled].T)
        self._faces.set_segments(faces(ground.points, filled))
        assert ground.heights is not None  # of a map
        means = ground.heights[: len(self._edges)]
        self._show_bins(means, ground.seen, ground.deviation)
        hold = f", held: {instant.held}" if instant.held else ""
        self._clock.set_text(f"{instant.time:5.1f} s{hold}")
        self._canvas.draw()
        return drawn_pixels(self._canvas)

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
