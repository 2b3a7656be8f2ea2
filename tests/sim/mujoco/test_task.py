"""The whole task in 3-D: environment, pictures, evaluation and training."""

import ctypes.util
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from flipperctl import api, checkpoint
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import HEIGHT, WIDTH
from flipperctl.errors import ConfigError, RequestError, TerrainError
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco import world as placing
from flipperctl.sim.mujoco.shown import _framing
from tests.cli.call import EXACT, call

DRAWS_HERE = any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa"))
draws = pytest.mark.skipif(not DRAWS_HERE, reason="this machine has neither EGL nor OSMesa")


@pytest.mark.parametrize("sim", [{"roughness": 0.1}, {"yaw": 0.7, "offset": 0.3}], ids=str)
def test_a_start_on_a_slope_lies_on_what_stands_above_the_line(
    sim: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = {"name": "building_stair", "steps": [8, 16]}
    ground = {"name": "midway", "terrain": inner, "start": 1.0}
    env = FlipperEnv(ground, sim={"name": "mujoco", **sim})

    def begin() -> None:
        for seed in range(8):
            env.reset(seed=seed)

    begin()
    monkeypatch.setattr(placing, "OVERLAP", 1.0)
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin()


def test_a_turned_robot_starts_behind_the_edge_that_its_corner_would_overlap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def begin(sim: dict[str, float], run_up: float) -> list[float]:
        env = FlipperEnv(
            {"name": "step", "height": [0.2, 0.3]},
            sim={"name": "mujoco", **sim},
            episode={"run_up": run_up, "start_noise": 0.0, "start_angle": 0.0},
        )
        found = []
        for seed in range(8):
            env.reset(seed=seed)
            found.append(env.drive.world.position[0] - env.profile.start)
        return found

    (straight, *_), turned = begin({}, 0.78), begin({"yaw": 0.4}, 0.78)
    assert min(turned) < straight - 0.01
    assert min(turned) >= straight - 0.36 * 0.4
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin({}, 0.7)
    monkeypatch.setattr(placing, "OVERLAP", 1.0)
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin({"yaw": 0.4}, 0.78)


@pytest.mark.long
def test_a_policy_is_trained_in_3d_and_evaluated_in_the_plane(tmp_path: Path) -> None:
    settings = [f"{key}={value}" for key, value in EXACT.items()]
    run = ["terrain=step", "sim=mujoco", "hydra.run.dir=run", *settings]
    done = call("train", *run, cwd=tmp_path)
    assert done.code == 0, done.err
    read = checkpoint.read(tmp_path / "run" / checkpoint.LAST)
    assert read.config().sim.plugin_name == "mujoco"
    other = call("eval", "run", "sim=planar,mujoco", "--episodes", "1", "--json", cwd=tmp_path)
    assert other.code == 0, other.err
    (found,) = json.loads(other.out)["engines"]
    assert found["engines"] == ["planar", "mujoco"]


# Pictures, from outside and of the robot's cameras, for films and for sensors


WALL = api.Profile([(0.0, 0.0), (0.0, 3.0), (1.0, 3.0)])
SIZE = 64, 48


@draws
def test_render_shows_the_world_in_3d_and_leaves_the_episode_alone() -> None:
    drawn, plain = (
        FlipperEnv("step", sim="mujoco", render_mode=mode) for mode in ("rgb_array", None)
    )
    for env in (drawn, plain):
        env.reset(seed=2)
    picture = drawn.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
    assert np.array_equal(picture, drawn.render())
    orange = (picture[..., 0] > 150) & (picture[..., 2] < 60)  # the front flippers
    assert orange.sum() > 1000
    assert np.array_equal(*(env.step(8)[0] for env in (drawn, plain)))
    assert plain.render() is None


@draws
@pytest.mark.parametrize(("length", "still"), [(0.5, True), (12.0, False)])
def test_the_camera_stands_still_on_a_course_that_it_shows_whole(
    length: float, still: bool
) -> None:
    block = api.Profile([(0.0, 0.0), (0.0, 0.2), (length, 0.2)])
    world = Mujoco().place(block, api.Robot(), api.Start(-1.0), np.random.default_rng(0))
    before = world.draw(240, 96)  # type: ignore[attr-defined]
    world.advance(200)
    changed = (before != world.draw(240, 96)).any(axis=2)  # type: ignore[attr-defined]
    assert changed[:, :120].any()
    assert changed[:, 160:].any() != still  # far ahead of the robot


def test_a_course_is_as_wide_as_its_picture() -> None:
    box = np.array([[-2.0, -0.4, 0.0], [4.0, 0.4, 0.8]])
    place, distance = _framing(box, 2.5)
    azimuth, elevation = math.radians(72), math.radians(-14)
    ahead = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    ahead *= math.cos(elevation)
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    corners = np.array(list(product(*box.T))) - place
    half = 2.5 * math.tan(math.radians(13)) * (distance + corners @ ahead)
    aside = corners @ right / half
    assert (aside.min(), aside.max()) == (pytest.approx(-1.0), pytest.approx(1.0))


def place(**sim: object) -> api.World:
    engine = Mujoco(**sim)  # type: ignore[arg-type]
    return engine.place(WALL, api.Robot(), api.Start(-1.28), np.random.default_rng(0))


@draws
def test_the_depth_is_the_distance_along_the_cameras_axis_and_the_motion_is_not_changed() -> None:
    plain, world = place(), place(camera_tilt=0.0, camera_angle=1.0)
    front, rear = (world.look(view, *SIZE) for view in ("front", "rear"))  # type: ignore[attr-defined]
    assert (front.pixels.shape, front.depth.shape) == ((48, 64, 3), (48, 64))
    # The camera is 0.28 m ahead of the chassis centre; the upper half sees the wall alone.
    assert front.depth[:20] == pytest.approx(1.0, abs=0.01)
    # 0.4 m above the ground, which the lowest row sees 0.5 rad below the axis of the rear camera.
    below = math.tan(0.5) * 47 / 48
    assert rear.depth[-1, 32] == pytest.approx(0.4 / below, rel=0.03)
    assert rear.depth[2, 32] == math.inf  # the sky
    assert np.array_equal(plain.advance(10), world.advance(10))


@dataclass(frozen=True)
class Nearest:
    """What a camera measures."""

    distance: float  # to the nearest surface in the middle [m]


class FrontCamera(api.Instrument):
    """Measures at 5 Hz how far the middle of the picture is."""

    period = 0.2

    def __init__(self, cameras: api.CameraWorld) -> None:
        self._cameras = cameras

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> Nearest:
        return Nearest(float(self._cameras.look("front", *SIZE).depth[24, 32]))


class Heights:
    """An estimator that knows no ground and remembers the distance as its pitch."""

    def __init__(self) -> None:
        self._distance = 0.0

    def update(self, measured: Measured) -> None:
        assert isinstance(measured.value, Nearest)
        self._distance = measured.value.distance

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        ground = SensedGround(np.zeros((0, 2)))
        return ground, SensedAngles(front=0.0, rear=0.0, pitch=self._distance)

    def save(self) -> float:
        return self._distance

    def load(self, saved: float) -> None:
        self._distance = saved


@pytest.fixture
def camera(registry: dict) -> None:
    """Register a sensor with a camera."""

    @api.sensor("camera")
    class Camera(api.Sensor):
        """Look ahead."""

        def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
            assert mounting.cameras is not None
            return {"front": FrontCamera(mounting.cameras)}

        def estimator(self, robot: api.RobotGeometry) -> Heights:
            return Heights()


@draws
@pytest.mark.usefixtures("camera")
def test_a_sensor_takes_pictures_between_decisions_as_films_do() -> None:
    sim = {"name": "mujoco", "camera_tilt": 0.5, "view": "front"}
    env = FlipperEnv("flat", sim=sim, perception="camera")
    env.reset(seed=1)
    # 0.4 m above level ground, 0.5 rad down; half a pixel lower than the middle
    assert env.perception.pitch == pytest.approx(0.4 / math.sin(0.5), rel=0.05)
    world = env.drive.world.of_engine
    assert np.array_equal(world.draw(*SIZE), world.look("front", *SIZE).pixels)


@pytest.mark.usefixtures("camera")
def test_engines_without_cameras_and_machines_that_cannot_draw_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(ConfigError, match="the sensor has a camera, which sim=planar lacks"):
        FlipperEnv("flat", perception="camera").reset(seed=1)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(RequestError, match="has neither EGL nor OSMesa: on Debian"):
        FlipperEnv("flat", sim="mujoco", perception="camera").reset(seed=1)
