"""Draw a scene from the side as a picture centred on the robot.

In: a scene. Out: an (H, W, 3) picture of the terrain, the robot, its perception and the candidate
angle of its front flippers. Agg draws without a screen and without matplotlib's global state;
equal scenes give equal pictures.
"""

from __future__ import annotations

import math
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, RobotGeometry, RobotState, candidate_angle
from flipperctl.env.pictures import HEIGHT, WIDTH, Perceived, Scene
from flipperctl.figures import settings
from flipperctl.sim import outline
from flipperctl.sim.outline import axles, belt_marks, outlines

# Colours for colour-blind readers (Okabe and Ito's; the purple is Paul Tol's).
# The reports use the same colour for the same object.
CHASSIS, FRONT, REAR, HEIGHTS = outline.CHASSIS, outline.FRONT, outline.REAR, "#AA4499"
GROUND, EARTH, BELT = outline.GROUND, outline.EARTH, outline.BELT
INK, FAINT = "#222222", "#757575"

_DPI = 100
_BOX = (0.06, 0.215, 0.925, 0.765)  # the axes in the figure: left, bottom, width, height [-]
_NUMBERS = {"time": 0.135, "x": 0.24, "pitch": 0.315, "front": 0.39, "rear": 0.465}  # right edge
_WORDS = {"action front, rear": 0.525, "terrain": 0.775}  # left edge [-] of the width
_TURNS = {-1: "down", 0: "hold", 1: "up"}
_LEVEL_GROUND = 60.0  # length of the level ground drawn before and past the profile [m]
_FLAG = np.array([[0.0, 0.0], [0.0, 0.55], [0.14, 0.5], [0.0, 0.45]])  # [m]


class RobotArtist:
    """The robot in an axes: flippers drawn over the chassis, and belts with moving marks."""

    def __init__(self, axes: Axes, zorder: float = 5.0, fade: float = 0.0) -> None:
        """``fade``: from 0, in its own colours, to 1, white."""
        chassis, front, rear, belt, ink = (
            tuple(fade + (1 - fade) * part for part in to_rgb(colour))
            for colour in (CHASSIS, FRONT, REAR, BELT, INK)
        )
        # The flippers lie over the chassis, those of the far side behind it, if they turn alone;
        # each has a belt, a body inside it, and marks on the belt.
        groups = (
            ([chassis], zorder), ([front, rear], zorder + 0.3), ([front, rear], zorder - 0.3)
        )  # fmt: skip
        self._belts = [PolyCollection([], facecolors=[belt], zorder=z) for _, z in groups]
        self._bodies = [
            PolyCollection([], facecolors=colours, zorder=z + 0.1) for colours, z in groups
        ]
        self._marks = [
            LineCollection([], colors="white", linewidths=1.0, zorder=z + 0.2) for _, z in groups
        ]
        for artist in (*self._belts, *self._bodies, *self._marks):
            axes.add_collection(artist, autolim=False)
        size = min(5.0, 0.5 * float(matplotlib.rcParams["font.size"]))
        (self._hinges,) = axes.plot(
            [], [], "o", color="white", markeredgecolor=ink, markersize=size, zorder=zorder + 0.6,
            scalex=False, scaley=False,
        )  # fmt: skip

    @property
    def artists(self) -> list[Artist]:
        """All artists of the robot, from the lowest to the highest."""
        parts = [*self._belts, *self._bodies, *self._marks, self._hinges]
        return sorted(parts, key=lambda artist: artist.get_zorder())

    def show(self, state: RobotState, robot: RobotGeometry, travel: float | None = None) -> None:
        """Draw the robot, and marks on its belts if their ``travel`` [m] is given."""
        ends, radius, depth = axles(state, robot), robot.track_radius, 0.28 * robot.track_radius
        outer, inner = outlines(state, robot), outlines(state, robot, inset=depth)
        for i, parts in enumerate((slice(0, 1), slice(1, 3), slice(3, 5))):
            self._belts[i].set_verts(list(outer[parts]))
            self._bodies[i].set_verts(list(inner[parts]))
            if travel is not None and len(ends[parts]):
                marks = [belt_marks(a, b, radius, travel, 3 * depth, depth) for a, b in ends[parts]]
                self._marks[i].set_segments(list(np.concatenate(marks)))
        self._hinges.set_data(ends[0, :, 0], ends[0, :, 1])


class Renderer:
    """Draw one picture per call into the same figure."""

    @settings()
    def __init__(self) -> None:
        figure = Figure((WIDTH / _DPI, HEIGHT / _DPI), _DPI, facecolor="white")
        self._canvas: Any = FigureCanvasAgg(figure)
        self._axes = figure.add_axes(_BOX, facecolor="#FBFBFD", axisbelow=True)
        self._build_axes(self._axes)
        self._build_scene(self._axes)
        self._build_caption(figure)

    @settings()
    def __call__(self, scene: Scene) -> NDArray[np.uint8]:
        """Return a picture of the scene, (HEIGHT, WIDTH, 3)."""
        self._look_at(scene)
        self._draw_ground(scene)
        self._robot.show(scene.state, scene.robot, scene.track_speed * scene.state.time)
        self._draw_perception(scene)
        self._write(scene)
        self._canvas.draw()
        return drawn_pixels(self._canvas)

    def _build_axes(self, axes: Axes) -> None:
        for axis, name, at in (
            (axes.xaxis, "x [m]", (0.5, -0.075)),
            (axes.yaxis, "z [m]", (-0.042, 0.5)),
        ):
            axis.set_major_locator(MultipleLocator(0.5))
            axis.set_label_text(name, fontsize=8, color=FAINT)
            axis.set_label_coords(*at)
        axes.tick_params(length=3, labelsize=8, colors=FAINT)
        axes.grid(True, color="#ECECF0", linewidth=0.8)
        for spine in axes.spines.values():
            spine.set_color("#C8C8CC")

    def _build_scene(self, axes: Axes) -> None:
        # The ground, and flags at start and finish
        self._earth = Polygon(np.zeros((3, 2)), facecolor=EARTH, edgecolor=GROUND, linewidth=1.6)
        axes.add_patch(self._earth)
        self._flags = []
        for name in ("start", "finish"):
            flag = Polygon(_FLAG, facecolor=FAINT, edgecolor=FAINT, linewidth=1.4, zorder=2)
            axes.add_patch(flag)
            label = axes.text(0, 0, name, fontsize=8, color=INK, va="bottom", clip_on=True)
            self._flags.append((flag, label))
        # What the robot perceives
        (self._heights,) = axes.plot(
            [], [], color=HEIGHTS, linewidth=2.6, solid_capstyle="butt", zorder=3,
            label="perceived mean heights H",
        )  # fmt: skip
        (self._points,) = axes.plot(
            [], [], ".", color=INK, markersize=2.2, zorder=4, label="sensed points"
        )
        (self._filled,) = axes.plot(
            [], [], "o", color=INK, markerfacecolor="none", markersize=3.0, markeredgewidth=0.6,
            zorder=4,
        )  # fmt: skip
        # The robot, and the candidate angle that a rule would turn to
        self._robot = RobotArtist(axes, zorder=5.0)
        (self._ray,) = axes.plot(
            [], [], color=INK, linewidth=1.4, dashes=(4, 2), zorder=5.5,
            label="candidate angle of the front flippers",
        )  # fmt: skip
        axes.legend(
            loc="upper left", ncols=3, fontsize=8, edgecolor="none", borderaxespad=0.3,
            handlelength=1.8, labelcolor=INK,
        ).set_zorder(9)  # fmt: skip

    def _build_caption(self, figure: Figure) -> None:
        self._values = {}
        for columns, side in ((_NUMBERS, "right"), (_WORDS, "left")):
            for name, at in columns.items():
                figure.text(at, 0.085, name, ha=side, fontsize=8, color=FAINT)
                self._values[name] = figure.text(
                    at, 0.03, "", ha=side, fontsize=12, color=INK, family="DejaVu Sans Mono"
                )

    def _look_at(self, scene: Scene) -> None:
        """Centre the view on the chassis, with equal axes that show robot and perceived ground."""
        robot = scene.robot
        width = 3.2 * max(_reach(scene.perceived), 1.5 * robot.reach)
        height = width * (_BOX[3] * HEIGHT) / (_BOX[2] * WIDTH)
        x, z = scene.state.position.tolist()
        self._axes.set_xlim(x - width / 2, x + width / 2)
        self._axes.set_ylim(z - height / 2, z + height / 2)

    def _draw_ground(self, scene: Scene) -> None:
        profile = Profile(scene.ground)
        line = profile.extended(_LEVEL_GROUND, _LEVEL_GROUND)
        deep = line[:, 1].min() - _LEVEL_GROUND
        self._earth.set_xy(np.vstack([line, [line[-1, 0], deep], [line[0, 0], deep]]))
        for (flag, label), x in zip(self._flags, (scene.start, scene.finish), strict=True):
            foot = np.array([x, profile.height(x)])
            flag.set_xy(_FLAG + foot)
            label.set_position(tuple(_FLAG[1] + foot))

    def _draw_perception(self, scene: Scene) -> None:
        p, state, robot = scene.perceived, scene.state, scene.robot
        cloud = p.points + state.position
        filled = np.zeros(len(cloud), np.bool_) if p.filled is None else p.filled
        for line, part in ((self._points, cloud[~filled]), (self._filled, cloud[filled])):
            line.set_data(part[:, 0], part[:, 1])
        bins = _bins(p) + state.position
        self._heights.set_data(bins[:, 0], bins[:, 1])
        # The candidate angle as a ray from the front hinge
        hinge = axles(state, robot)[0, 1]
        angle = state.pitch + candidate_angle(p.points, p.pitch, robot)
        length = robot.flipper_axle + 2.5 * robot.track_radius
        tip = hinge + length * np.array([math.cos(angle), math.sin(angle)])
        self._ray.set_data([hinge[0], tip[0]], [hinge[1], tip[1]])

    def _write(self, scene: Scene) -> None:
        state, action, outcome = scene.state, scene.action, scene.outcome
        angles = {}
        for name in ("pitch", "front", "rear"):
            angle = round(math.degrees(getattr(state, name)))
            angles[name] = f"{angle:+d}°" if angle else "0°"
        doing = [] if action is None else [", ".join(_TURNS[turn] for turn in action)]
        doing += [] if outcome is None else [outcome.value]
        texts = {
            "time": f"{state.time:.1f} s",
            "x": f"{state.position[0]:.2f} m",
            **angles,
            "action front, rear": " → ".join(doing) or "–",
            "terrain": scene.terrain,
        }
        for name, text in texts.items():
            self._values[name].set_text(text.replace("-", "−"))


def drawn_pixels(canvas: Any) -> NDArray[np.uint8]:
    """Return a copy of what was drawn on a canvas of Agg, (H, W, 3)."""
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3]


def _reach(p: Perceived) -> float:
    """Return half the length of the perceived ground [m]."""
    return len(p.heights) * p.bin_width / 2


def _bins(p: Perceived) -> FloatArray:
    """Return the perceived heights as a line with gaps between bins, (3·N, 2) in frame L [m]."""
    count, gap = len(p.heights), 0.06 * p.bin_width
    left = -_reach(p) + p.bin_width * np.arange(count)
    x, z = np.full((2, count, 3), np.nan)
    x[:, 0], x[:, 1] = left + gap, left + p.bin_width - gap
    z[:, :2] = p.heights[:, None]
    return np.column_stack([x.ravel(), z.ravel()])
