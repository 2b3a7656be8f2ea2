"""Check that a terrain can be drawn: the first video frame, and sketches at the field bounds."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from flipperctl.api import Terrain
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.report.render import CHASSIS, EARTH, Renderer, RobotArtist
from flipperctl.testing.check import require
from flipperctl.testing.terrain import environment

_MIN_AREA = 1e-3
"""Smallest fraction of the picture that ground and chassis must each cover [-]."""


def shows_ground_and_robot(terrain: Terrain, full: bool) -> None:
    """Check that ground and robot are visible in a video frame if ``full``, else in a sketch."""
    env = environment(terrain)
    env.reset(seed=0)
    picture = _renderer()(env.scene) if full else _sketch()(env)
    for what, colour in (("ground", EARTH), ("robot", CHASSIS)):
        near = np.abs(picture.astype(int) - _bytes(colour)).max(axis=2) <= 8
        require(float(near.mean()) >= _MIN_AREA, f"its picture shows no {what} (in {colour})")


def _bytes(colour: str) -> NDArray[np.int_]:
    return np.array([round(255 * part) for part in to_rgb(colour)])


class _Sketch:
    """Draw the ground within 2.5 m of the robot, without the text that makes a frame slow."""

    def __init__(self) -> None:
        self._figure = Figure((2.5, 1.25), 60)
        self._canvas: Any = FigureCanvasAgg(self._figure)
        axes = self._axes = self._figure.add_axes((0, 0, 1, 1), frame_on=False)
        axes.set_axis_off()
        self._earth = Polygon(np.zeros((3, 2)), facecolor=EARTH)
        axes.add_patch(self._earth)
        self._robot = RobotArtist(axes)

    def __call__(self, env: FlipperEnv) -> NDArray[np.uint8]:
        line = env.profile.extended(10.0, 10.0)
        deep = line[:, 1].min() - 10.0
        self._earth.set_xy(np.vstack([line, [line[-1, 0], deep], [line[0, 0], deep]]))
        self._robot.show(env.state, env.robot)
        x, z = env.state.position.tolist()
        self._axes.set_xlim(x - 2.5, x + 2.5)
        self._axes.set_ylim(z - 1.25, z + 1.25)
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3]


@cache
def _sketch() -> _Sketch:
    return _Sketch()


@cache
def _renderer() -> Renderer:
    return Renderer()
