"""The picture of the scene, and the outlines that it is made of."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Outcome, RobotGeometry, RobotState
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import HEIGHT
from flipperctl.figures.render import CHASSIS, EARTH, Renderer
from flipperctl.sim.outline import capsule, outlines

ROBOT = RobotGeometry()
MIDDLE = (193, 502)  # row and column of the chassis centre, to which the view is tied [px]
SCALE = 888 / 3.6  # 0.925 of 960 px show 3.2 times the perceived 1.125 m [px/m]

Picture = NDArray[np.uint8]


def at(x: float, z: float, pitch: float = 0.0, front: float = 0.0, rear: float = 0.0) -> RobotState:
    return RobotState(np.array([x, z]), pitch, front, rear, np.zeros(2), 0.0, 0.0)


def coloured(picture: Picture, colour: str) -> FloatArray:
    """Return pixels relative to the chassis centre, right and up positive, (P, 2) [px]."""
    rows, columns = np.nonzero((picture == np.rint(255 * np.array(to_rgb(colour)))).all(axis=2))
    return np.column_stack([columns - MIDDLE[1], MIDDLE[0] - rows]).astype(np.float64)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer()


@pytest.fixture
def env() -> FlipperEnv:
    env = FlipperEnv("paper_step", render_mode="rgb_array")
    env.reset(seed=1)
    return env


def test_equal_states_give_equal_pictures(env: FlipperEnv, renderer: Renderer) -> None:
    first = renderer(env.scene)
    env.step(8)
    assert not np.array_equal(first, renderer(env.scene))
    env.reset(seed=1)
    assert np.array_equal(first, renderer(env.scene))
    assert np.array_equal(first, Renderer()(env.scene))
    told = renderer(replace(env.scene, action=(1, 0), outcome=Outcome.REACHED))
    assert np.nonzero((first != told).any(axis=2))[0].min() > 0.85 * HEIGHT  # in the caption


@pytest.mark.parametrize("pitch", [-0.5, 0.6])
def test_the_chassis_is_where_and_as_the_state_says(
    env: FlipperEnv, renderer: Renderer, pitch: float
) -> None:
    env.drive.state = at(-0.6, 0.9, pitch)
    pixels = coloured(renderer(env.scene), CHASSIS)
    assert np.abs(pixels.mean(axis=0)).max() < 1.5
    _, axes = np.linalg.eigh(np.cov(pixels.T))
    long_axis = axes[:, 1]
    assert math.atan(long_axis[1] / long_axis[0]) == pytest.approx(pitch, abs=0.02)
    thickness = np.ptp(pixels @ axes[:, 0])
    assert thickness / SCALE == pytest.approx(2 * 0.072, abs=0.015)  # 0.028 m is belt


def test_the_ground_is_to_scale(env: FlipperEnv, renderer: Renderer) -> None:
    for x in (-0.8, -0.7):
        env.drive.state = at(x, 0.1)
        earth = coloured(renderer(env.scene), EARTH)
        above_level = earth[earth[:, 1] > 0.1 * SCALE]  # 0.2 m up, only the step is left
        assert above_level[:, 0].min() == pytest.approx(-x * SCALE, abs=4)
        assert above_level[:, 1].max() == pytest.approx(0.3 * SCALE, abs=4)


@pytest.mark.long
def test_matplotlib_is_loaded_late_and_pyplot_never() -> None:
    code = (
        "import sys, flipperctl.env.flipper_env as e; assert 'matplotlib' not in sys.modules;"
        "env = e.FlipperEnv('flat', render_mode='rgb_array'); env.reset(seed=0); env.render();"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_capsule_by_hand() -> None:
    points = capsule((0, 0), (1, 0), 0.5, arc=3)
    assert points == pytest.approx(
        np.array([[0, 0.5], [1, 0.5], [1.5, 0], [1, -0.5], [0, -0.5], [-0.5, 0]]), abs=1e-12
    )


def test_the_level_robot_is_as_long_as_the_paper_says() -> None:
    parts = outlines(at(2.0, 0.1), ROBOT)
    lengths = np.ptp(parts[:, :, 0], axis=1)
    assert lengths == pytest.approx([0.76, 0.536, 0.536])
    assert np.ptp(parts[:, :, 1], axis=1) == pytest.approx([0.2, 0.2, 0.2])
    assert parts[1, :, 0].max() == pytest.approx(2.0 + 0.28 + 0.336 + 0.1)
    assert parts[2, :, 0].min() == pytest.approx(2.0 - 0.28 - 0.336 - 0.1)
    inner = outlines(at(2.0, 0.1), ROBOT, inset=0.02)
    assert np.ptp(inner[0], axis=0) == pytest.approx([0.72, 0.16])


def test_a_scene_is_plain_data_that_another_process_can_draw(
    env: FlipperEnv, renderer: Renderer
) -> None:
    scene = env.scene
    assert np.array_equal(renderer(pickle.loads(pickle.dumps(scene))), renderer(scene))
    told = json.loads(json.dumps(scene.to_dict()))
    assert told["state"]["position"] == scene.state.position.tolist()
    assert told["perceived"]["heights"] == env.perception.observation[:15].tolist()
    assert (told["robot"]["track_radius"], told["outcome"]) == (0.1, None)
