"""Figures of terrains, episodes and methods, and writing them to files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from flipperctl.api import Profile, RobotGeometry
from flipperctl.config import EvalConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.plan import Entry
from flipperctl.figures.episode import episode_figure, spread
from flipperctl.figures.figure import save
from flipperctl.figures.render import BELT, Renderer
from flipperctl.figures.terrain import contact_sheet, terrain_figure
from flipperctl.policies.source import PolicySource
from flipperctl.requests.evaluation import picture_names
from flipperctl.rollout.trace import Trace

ROBOT = RobotGeometry()
STEP = Profile([(0.0, 0.0), (0.0, 0.3), (2.0, 0.3)])
LEVEL = Profile([(0.0, 0.0), (2.0, 0.0)])


def texts(figure: Figure) -> str:
    return "\n".join(text.get_text() for axes in figure.axes for text in axes.texts)


def trace(metres: float = 6.0, states: int = 61, ground: Profile = STEP, **more: Any) -> Trace:
    x = np.linspace(0.0, metres, states)
    values = {"pitch": 0.2, "front": 0.3, "rear": -0.1}
    angles = {name: np.full(states, value) for name, value in values.items()}
    poses: dict[str, Any] = {"time": 5 * x, "position": np.stack([x, np.full(states, 0.1)], 1)}
    decided = {"decided": np.zeros(1), "actions": np.zeros((1, 2)), "heights": np.zeros((1, 0))}
    place: dict[str, Any] = {"robot": ROBOT, "ground": ground.points, "bin_width": 0.15}
    return Trace(**place | angles | poses | decided | more)


def test_terrain_draws_the_robot_to_scale_before_the_first_edge() -> None:
    axes = terrain_figure([STEP], ROBOT).axes[0]
    belts = [c for c in axes.collections if np.array_equal(c.get_facecolor(), [to_rgba(BELT)])]
    robot = np.vstack([path.vertices for belt in belts for path in belt.get_paths()])
    assert robot[:, 0].min() == pytest.approx(-1.0 - 0.716)
    assert robot[:, 0].max() == pytest.approx(-1.0 + 0.716)
    assert axes.get_aspect() == 1.0
    words = texts(axes.figure)
    assert "length 2.00 m" in words
    assert "height 0.30 m" in words
    assert axes.get_title(loc="left") == ""


def test_terrain_shows_twelve_more_draws_and_counts_the_rest(tmp_path: Path) -> None:
    figure = terrain_figure([STEP] * 20, ROBOT)
    assert len(figure.axes) == 13
    assert figure.axes[1].get_title() == "sample 2: 2.00 × 0.30 m"
    assert figure.get_supxlabel() == "7 more samples are not shown"
    few = terrain_figure([STEP] * 6, ROBOT)  # five small ones, which fill two rows
    assert few.axes[1].get_subplotspec().get_gridspec().ncols == 3
    assert few.axes[1].get_xlim() == pytest.approx((-0.5, 2.5))
    assert few.axes[1].get_ylim() == pytest.approx((-0.15, 0.45))
    up, down = Profile([(0, 0), (0, 0.4)]), Profile([(5, 1), (5, 0.8)])
    _, rising, falling = terrain_figure([STEP, up, down], ROBOT).axes
    assert rising.get_ylim() == pytest.approx((-0.2 - 0.15, 0.4 + 0.15))
    assert np.subtract(falling.get_ylim(), rising.get_ylim()) == pytest.approx(1.0)  # one base line
    point, drop = Profile([(0, 0)]), Profile([(0, 0), (0, -0.4)])
    save(terrain_figure([point, drop], ROBOT), tmp_path / "odd.png")


def test_pictures_of_a_contact_sheet_have_one_scale() -> None:
    high = Profile([(0, 0), (0, 9.0)])
    figure = contact_sheet({"step": STEP, "high": high, "point": Profile([(0, 0)])}, ROBOT)
    figure.draw_without_rendering()
    sizes = [axes.get_window_extent().size for axes in figure.axes]
    extents = [(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())) for axes in figure.axes]
    scales = np.divide(sizes, extents)
    assert scales == pytest.approx(np.full((3, 2), scales[0, 0]))
    words = [[text.get_text() for text in axes.texts] for axes in figure.axes]
    assert words == [["1 m"], ["goes on ↑"], []]


def test_times_of_poses_stay_apart_and_near_their_poses() -> None:
    assert spread([0.0, 1.0, 1.2, 5.0], 1.0) == pytest.approx([-0.2666667, 0.7333333, 1.7333333, 5])
    assert spread([], 1.0) == []


def test_episode_marks_the_same_poses_in_both_panels() -> None:
    figure = episode_figure(trace())
    above, below = figure.axes
    times = [0, 6, 12, 18, 24, 30]
    assert [text.get_text() for text in above.texts] == [f"{time:.1f} s" for time in times]
    curves = {str(line.get_label()): line for line in below.get_lines()}
    assert np.asarray(curves["pitch"].get_ydata())[0] == pytest.approx(math.degrees(0.2))
    assert np.asarray(curves["rear flippers"].get_ydata())[0] == pytest.approx(math.degrees(-0.1))
    upright = [line for line in below.get_lines() if line.get_linestyle() == ":"]
    assert [np.asarray(line.get_xdata())[0] for line in upright] == pytest.approx(times)
    (start,) = episode_figure(trace(0.0, 1, LEVEL)).axes[0].texts
    assert start.get_text() == "0.0 s"


OF_A_USER: dict[str, Any] = {
    **matplotlib.style.library["dark_background"],
    **{"savefig.bbox": "tight", "savefig.dpi": 50, "savefig.transparent": True, "figure.dpi": 30},
    **{"svg.fonttype": "none", "pdf.use14corefonts": True, "axes.unicode_minus": False},
    **{"font.family": "monospace", "font.sans-serif": ["DejaVu Serif"], "text.antialiased": False},
    **{"path.simplify": False, "lines.antialiased": False, "axes.formatter.use_mathtext": True},
}


@pytest.mark.parametrize(
    ("name", "magic"), [("a.png", b"\x89PNG"), ("a.svg", b"<?xml"), ("a.PDF", b"%PDF")]
)
def test_save_writes_by_suffix_and_the_same_whatever_the_user_s_settings_are(
    name: str, magic: bytes, tmp_path: Path
) -> None:
    path = tmp_path / name
    save(terrain_figure([STEP], ROBOT), path)
    first = path.read_bytes()
    assert first.startswith(magic)
    with matplotlib.rc_context(OF_A_USER):
        before = dict(matplotlib.rcParams)
        save(terrain_figure([STEP], ROBOT), path)
        assert dict(matplotlib.rcParams) == before
    assert path.read_bytes() == first
    assert list(tmp_path.iterdir()) == [path]


def test_pictures_of_the_environment_do_not_depend_on_the_user_s_settings() -> None:
    env = FlipperEnv("flat", render_mode="rgb_array")
    env.reset(seed=0)
    first = Renderer()(env.scene)
    with matplotlib.rc_context(OF_A_USER):
        assert np.array_equal(Renderer()(env.scene), first)


def test_each_scene_of_an_evaluation_has_a_picture_of_its_own() -> None:
    flat = EvalConfig(terrain="flat")
    step = with_overrides(flat, {"terrain": "step"})
    varied = with_overrides(flat, {"randomise.sim.friction": [0.6, 1.0]})
    nominal_hash, varied_hash = Conditions.of(flat).hash, Conditions.of(varied).hash
    level = PolicySource(settings={"name": "level"})
    assert picture_names([Entry(config, level) for config in (flat, step, varied, flat)]) == [
        f"flat_nominal_{nominal_hash}_1.png",
        "step.png",
        f"flat_nominal_{varied_hash}.png",
        f"flat_nominal_{nominal_hash}_2.png",
    ]
