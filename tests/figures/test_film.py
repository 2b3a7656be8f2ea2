"""Films and pictures of an episode, from the side or by an engine that draws itself."""

import ctypes.util
from dataclasses import replace

import matplotlib.style
import numpy as np
import pytest
from PIL import Image

from flipperctl.api import SAMPLE_PERIOD, Profile, Robot, RobotState, Start, Transition
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError, MissingExtraError, RequestError
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.evaluation.replay import EpisodeRecord
from flipperctl.figures.animation import FILM, LAST, check_film
from flipperctl.figures.episode import episode_figure
from flipperctl.figures.film import Part, SideView, Take, _Shots, film
from flipperctl.policies.source import load_policy
from flipperctl.requests.replay import replay_file
from flipperctl.rollout.episode import play
from flipperctl.rollout.trace import Trace, instants, map_points, mapped
from flipperctl.sim.mujoco import Mujoco, shown
from flipperctl.sim.mujoco.world import MujocoWorld
from flipperctl.text.files import check_output, write_json

STEP = Profile([(0.0, 0.0), (0.0, 0.2), (0.5, 0.2)])
LEVEL = load_policy("level", "--controller")
DRAWS_HERE = any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa"))


def state(x, front, time):
    return RobotState(np.array([x, 0.1]), 0.0, front, 0.0, np.array([0.2, 0.0]), 0.0, time)


def drive(decisions):
    """A robot at 0.2 m/s whose front flippers rise by 0.3 rad in each decision of 0.6 s."""
    made = []
    for n in range(decisions):
        before, after = (state(0.12 * k - 1, 0.3 * k, 0.6 * k) for k in (n, n + 1))
        x = np.linspace(before.position[0], after.position[0], 61)
        path = np.column_stack([x, np.full(61, 0.1), np.zeros(61)])
        flippers = np.column_stack([np.linspace(before.front, after.front, 61), np.zeros(61)])
        given = before, after, np.zeros(n + 2), (1, 0), STEP, Robot(), None, path
        made.append(Transition(*given, flippers=flippers))
    return made


def test_the_instants_are_evenly_spaced_over_decisions_and_include_the_end():
    shown = list(instants(drive(2), 0.25))
    assert [s.time for s in shown] == pytest.approx([0, 0.25, 0.5, 0.75, 1, 1.2])
    assert [s.position[0] for s in shown] == pytest.approx([-1, -0.95, -0.9, -0.85, -0.8, -0.76])
    assert [s.front for s in shown] == pytest.approx([0, 0.125, 0.25, 0.375, 0.5, 0.6])
    bare = [replace(t, path=np.empty((0, 3)), flippers=np.empty((0, 2))) for t in drive(3)]
    assert list(Trace.of(bare, STEP).time) == pytest.approx([0, 0.6, 1.2, 1.8])


SHORT = {"terrain": {"name": "flat", "length": 0.2}, "episode": {"run_up": 0.4, "run_out": 0.4}}
FLAT, FLAT_3D = EvalConfig(**SHORT), EvalConfig(**SHORT, sim="mujoco")
OKADA = load_policy("okada", "--controller")


def take(config, *names):
    sources = {"level": LEVEL, "okada": OKADA}
    return Take("flat, episode 0", [Part(name, config, sources[name], 3) for name in names])


def frames(path):
    with Image.open(path) as picture:
        found = []
        for index in range(picture.n_frames):
            picture.seek(index)
            found.append((np.array(picture.convert("RGB")), picture.info["duration"]))
        return found


def test_a_film_moves_lasts_as_long_as_it_says_and_is_equal_for_equal_episodes(tmp_path):
    paths, done = [tmp_path / "one.gif", tmp_path / "two.gif"], []
    for path, style in zip(paths, ("default", "dark_background"), strict=True):
        with matplotlib.style.context(style):
            film(path, [take(FLAT, "level")], speed=3, report_progress=done.append)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    check_output(paths[0], FILM)  # a film of before is replaced
    assert done[-1] == 1
    time = play(FlipperEnv(config=FLAT), LEVEL.build(FLAT), 3)["t_cost"]
    found = frames(paths[0])
    shown = sum(duration for _, duration in found[:-1]) / 1000  # [s]; equal frames are merged
    assert shown == pytest.approx(time / 3, abs=0.05)
    assert (found[0][0] != found[-1][0]).any()


def test_policies_are_stacked_and_takes_follow_each_other(tmp_path):
    sizes, counts = [], []
    takes = [take(FLAT, "level")], [take(FLAT, "level", "okada")], 2 * [take(FLAT, "level")]
    for number, chosen in enumerate(takes):
        film(tmp_path / f"{number}.gif", chosen, speed=8)
        found = frames(tmp_path / f"{number}.gif")
        sizes.append(found[0][0].shape)
        counts.append(len(found))
    alone, two, twice = sizes
    assert alone == twice
    assert two[1] == alone[1]
    assert counts[2] == pytest.approx(2 * counts[0], abs=2)


def test_an_mp4_has_the_frames_of_its_time(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "film.mp4"
    film(path, [take(FLAT, "level")], speed=3)
    check_output(path, FILM)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    time = play(FlipperEnv(config=FLAT), LEVEL.build(FLAT), 3)["t_cost"]
    assert seconds == pytest.approx(time / 3 + LAST, abs=0.15)
    assert count == pytest.approx(25 * seconds, abs=2)


def test_an_mp4_without_its_package_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"flipperctl\[video\]"):
        check_film(tmp_path / "film.mp4")


@pytest.fixture(scope="module")
def driven():
    env = FlipperEnv("step", perception={"name": "lidar", "azimuths": 60})
    env.reset(seed=1)
    made = []
    for _ in range(3):
        env.step(4)
        made.append(env.transition)
    return made, env.profile


def test_a_picture_has_the_map_without_filled_points_and_the_heights_over_time(driven):
    made, profile = driven
    (p, *_) = mapped(made)
    points = map_points(p, made[0].before.position)
    assert len(points) == np.count_nonzero(~p.filled) < len(p.points)
    before = points[points[:, 0] < profile.start - 0.1]
    assert np.abs(before[:, 1] - profile.height(profile.start - 1)).max() < 0.06
    figure = episode_figure(Trace.of(made, profile))
    above, below, lowest, _ = figure.axes  # the last one is the bar of colours
    (shown,) = (line for line in above.get_lines() if line.get_label() == "map")
    assert len(np.asarray(shown.get_xdata())) > 100
    assert lowest.get_xlim() == below.get_xlim()
    (mesh,) = lowest.collections
    heights = np.ma.filled(np.ma.masked_invalid(np.asarray(mesh.get_array())), np.nan)
    heights, seen = heights.reshape(15, 3)[:, 0], p.seen
    assert heights[seen] == pytest.approx(p.observation[:15][seen])
    assert np.isnan(heights[~seen]).all()


def test_a_film_draws_the_map_only_if_the_sensor_has_one(driven):
    made, profile = driven
    blind = [replace(t, perception=None) for t in made]
    assert mapped(blind) == []
    pictures = []
    for transitions in (made, blind):
        view = SideView(transitions[:1], profile, 0.2, 0.12)
        view.prepare(view.box, SideView.height(view.box), angles=True)
        pictures.append(view.picture(0))
    assert (pictures[0] != pictures[1]).any()


@pytest.fixture
def drawn(monkeypatch):
    """Draw pictures whose first pixel counts the samples."""

    def draw(self, width, height):
        picture = np.zeros((height, width, 3), np.uint8)
        picture[:, :, 0] = self._samples % 251  # neighbours differ, or a GIF merges them
        return picture

    monkeypatch.setattr(MujocoWorld, "draw", draw)


@pytest.mark.usefixtures("drawn")
def test_an_engine_that_draws_itself_is_filmed_without_changing_the_episode(tmp_path):
    poses, rows, shots = [], [], _Shots(20, 48)
    for observers in ([], [shots]):
        env, found = FlipperEnv(config=FLAT_3D), []
        watch = lambda decision, found=found: found.append(decision.poses)  # noqa: E731
        rows.append(play(env, LEVEL.build(FLAT_3D), 3, watch=watch, observers=observers))
        poses.append(np.concatenate(found))
    assert rows[0] == rows[1]
    assert np.array_equal(*poses)
    count = round(rows[0]["t_cost"] / SAMPLE_PERIOD)
    assert [int(p[0, 0, 0]) for p, *_ in shots.taken] == [n % 251 for n in range(0, count + 1, 20)]
    assert shots.taken[-1][2] <= rows[0]["pitch_variation_100hz"] + 1e-9
    row = EpisodeRunner(FLAT_3D, LEVEL, 0).play(0)
    record = EpisodeRecord.of(FLAT_3D, LEVEL, row).model_dump(mode="json")
    write_json(tmp_path / "failure.json", record)
    replay_file(tmp_path / "failure.json", None, None, tmp_path / "again.gif")
    with Image.open(tmp_path / "again.gif") as picture:
        assert picture.width == 720
        assert picture.n_frames == pytest.approx(1.0 / 0.2 / 3 / 0.08, abs=3)  # 1 m


def draw(width=64, height=48):
    world = Mujoco().place(
        Profile([(0, 0), (0, 0.1)]), Robot(), Start(-0.8), np.random.default_rng(0)
    )
    return world.draw(width, height)


def test_a_driver_that_cannot_draw_is_named_and_pictures_have_a_largest_size(monkeypatch):
    def fail(name):
        raise RuntimeError("no device")

    with pytest.raises(RequestError, match="at most 1920 × 1080 are allowed"):
        draw(1921, 1080)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: "there")
    monkeypatch.setattr(shown, "import_module", fail)
    with pytest.raises(FlipperctlError, match=r"EGL cannot draw .*\(no device\).*MUJOCO_GL=osmesa"):
        draw()


@pytest.mark.skipif(not DRAWS_HERE, reason="this machine has neither EGL nor OSMesa")
def test_a_picture_shows_the_robot_before_the_sky():
    picture = draw(160, 120)
    assert picture.shape == (120, 160, 3)
    assert picture[2].mean(axis=0)[2] > 200  # bright and bluish above
    robot = (picture[..., 0] > 150) & (picture[..., 2] < 60)
    assert robot.sum() > 100  # the front flippers
