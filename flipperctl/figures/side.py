"""An episode from the side, instant by instant: the robot on its ground, and its angles over time.

In: the transitions of an episode, and the part of the world to show. Out: pictures of instants.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, RobotState, Transition
from flipperctl.figures.episode import draw_angles, window
from flipperctl.figures.figure import SCREEN, draw_ground, frame, scaled, styled
from flipperctl.figures.render import FAINT, HEIGHTS, RobotArtist
from flipperctl.rollout.trace import instants, map_points, mapped
from flipperctl.sim.outline import outlines

_DPI = 100
_HIGHEST = 5.0
"""Largest height of the ground's part of a picture [in]."""


class SideView:
    """One figure of which each instant redraws only the moving parts.

    The points of a sensor that maps the ground are drawn as of the latest decision.
    """

    def __init__(
        self, transitions: Sequence[Transition], profile: Profile, speed: float, period: float
    ) -> None:
        """``speed``: that of the belts [m/s]; ``period``: time between two instants [s]."""
        self._robot, self._speed, self._profile = transitions[0].robot, speed, profile
        self.states: list[RobotState] = list(instants(transitions, period))
        self._maps = _maps(transitions, self.states)

    @property
    def box(self) -> FloatArray:
        """Lower left and upper right corner of what the episode needs, (2, 2) in world [m]."""
        robot = self._robot
        reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius
        top = max(float(outlines(state, robot)[:, :, 1].max()) for state in self.states)
        path = np.array([state.position for state in self.states])  # (T, 2) [m]
        return np.stack(window(path, self._profile, reach, top))

    @staticmethod
    def height(box: FloatArray) -> float:
        """Return the height of the ground's part of a picture of a box [in]."""
        return scaled(box[0], box[1], _HIGHEST, SCREEN)[1]

    def prepare(self, box: FloatArray, height: float, *, angles: bool) -> None:
        """Draw what does not move; ``angles``: whether they are drawn below the ground."""
        with styled("screen"):
            self._prepare(box, height, angles)

    def _prepare(self, box: FloatArray, height: float, angles: bool) -> None:
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
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3]


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
