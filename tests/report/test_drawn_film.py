"""Films and pictures of an engine that draws itself."""

import ctypes.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from flipperctl.api import SAMPLE_PERIOD, Profile, Robot, Start
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.evaluation.episode_record import EpisodeRecord
from flipperctl.evaluation.views.replay import replay_file
from flipperctl.evaluation.workers import EpisodeRunner
from flipperctl.figures.film import Shots, film
from flipperctl.files import write_json
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import play
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld

LEVEL = PolicySource.of_plugin("level", "--controller")
DRAWS_HERE = any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa"))


def place(x: float = -0.8) -> Any:
    return Mujoco().place(Profile([(0, 0), (0, 0.1)]), Robot(), Start(x), np.random.default_rng(0))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pictures whose first pixel counts the samples."""

    def draw(self: MujocoWorld, width: int, height: int) -> np.ndarray:
        picture = np.zeros((height, width, 3), np.uint8)
        picture[:, :, 0] = self._samples % 251  # neighbours differ, or a GIF merges them
        return picture

    monkeypatch.setattr(MujocoWorld, "draw", draw)


@pytest.mark.usefixtures("drawn")
def test_a_filmed_episode_runs_as_it_does_alone() -> None:
    config = EvalConfig(terrain={"name": "flat", "length": 0.5}, sim="mujoco")
    poses, rows, shots = [], [], Shots("mujoco")
    for observers in ([], [shots]):
        env, found = FlipperEnv(config=config), []
        watch = lambda decision, found=found: found.append(decision.poses)  # noqa: E731
        rows.append(play(env, LEVEL.build(config), 3, watch=watch, observers=observers))
        poses.append(np.concatenate(found))
    assert rows[0] == rows[1]
    assert np.array_equal(*poses)
    samples = round(rows[0]["t_cost"] / SAMPLE_PERIOD)
    counted = [int(frame[0, 0, 0]) for frame in shots.frames]
    assert counted == [n % 251 for n in range(0, samples + 1, 20)]


@pytest.mark.usefixtures("drawn")
def test_a_film_is_an_animation_of_the_whole_episode(tmp_path: Path) -> None:
    config = EvalConfig(terrain={"name": "flat", "length": 0.5}, sim="mujoco")
    film(config, LEVEL, 0, tmp_path / "drive.gif")
    with Image.open(tmp_path / "drive.gif") as picture:
        frames = getattr(picture, "n_frames", 1)
        assert picture.size == (640, 480)
    assert frames == pytest.approx(2.5 / 0.2 * 5, abs=3)  # 2.5 m at 0.2 m/s, 5 pictures a second


def test_an_engine_without_pictures_has_no_film(tmp_path: Path) -> None:
    config = EvalConfig(terrain="step")
    with pytest.raises(RequestError, match="sim=planar draws no pictures"):
        film(config, LEVEL, 0, tmp_path / "drive.gif")


@pytest.mark.usefixtures("drawn")
def test_a_recorded_episode_is_filmed_by_its_engine(tmp_path: Path) -> None:
    config = EvalConfig(terrain={"name": "flat", "length": 0.5}, sim="mujoco")
    row = EpisodeRunner(config, LEVEL, 0).play(0)
    record = EpisodeRecord.of(config, LEVEL, row).model_dump(mode="json")
    write_json(tmp_path / "failure.json", record)
    replay_file(tmp_path / "failure.json", None, None, tmp_path / "again.gif")
    with Image.open(tmp_path / "again.gif") as picture:
        assert picture.size == (640, 480)


@pytest.mark.parametrize(
    ("variable", "words"),
    [("", "has neither EGL nor OSMesa: on Debian, apt install libegl1"), ("egl", "has no EGL")],
)
def test_without_a_library_the_error_names_what_to_install(
    variable: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", variable)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(RequestError, match=words):
        place().draw(64, 48)


def test_a_driver_that_cannot_draw_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from flipperctl.sim.mujoco import camera

    def fail(name: str) -> None:
        raise RuntimeError("no device")

    monkeypatch.setattr(ctypes.util, "find_library", lambda name: "there")
    monkeypatch.setattr(camera, "import_module", fail)
    with pytest.raises(FlipperctlError, match=r"EGL cannot draw .*\(no device\).*MUJOCO_GL=osmesa"):
        place().draw(64, 48)


def test_a_picture_has_a_largest_size() -> None:
    with pytest.raises(RequestError, match="at most 1920 × 1080 are allowed"):
        place().draw(1921, 1080)


@pytest.mark.skipif(not DRAWS_HERE, reason="this machine has neither EGL nor OSMesa")
def test_a_picture_shows_the_robot_before_the_sky() -> None:
    picture = place().draw(160, 120)
    assert picture.shape == (120, 160, 3)
    sky = picture[2].mean(axis=0)
    assert sky[2] > 200  # bright and bluish above
    robot = (picture[..., 0] > 150) & (picture[..., 2] < 60)
    assert robot.sum() > 100  # orange boards of the tracks
