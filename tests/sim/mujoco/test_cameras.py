"""The robot's front and rear camera, for sensors and for films."""

import ctypes.util
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from flipperctl import api
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, RequestError
from flipperctl.sim.mujoco import Mujoco

DRAWS_HERE = any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa"))
draws = pytest.mark.skipif(not DRAWS_HERE, reason="this machine has neither EGL nor OSMesa")
WALL = api.Profile([(0.0, 0.0), (0.0, 3.0), (1.0, 3.0)])
SIZE = 64, 48


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

    def __init__(self, bins: int) -> None:
        self._heights, self._distance = np.zeros(bins), 0.0

    def update(self, measured: Measured) -> None:
        assert isinstance(measured.value, Nearest)
        self._distance = measured.value.distance

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        ground = SensedGround(np.zeros((0, 2)), self._heights)
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
            return Heights(self.bins)


@draws
@pytest.mark.usefixtures("camera")
def test_a_sensor_takes_pictures_between_decisions_and_films_show_them() -> None:
    sim = {"name": "mujoco", "camera_tilt": 0.5, "view": "front"}
    env = FlipperEnv("flat", sim=sim, perception="camera")
    env.reset(seed=1)
    # 0.4 m above level ground, 0.5 rad down; half a pixel lower than the middle
    assert env.perception.pitch == pytest.approx(0.4 / math.sin(0.5), rel=0.05)
    world = env.drive.world.unguarded
    assert np.array_equal(world.draw(*SIZE), world.look("front", *SIZE).pixels)
    assert env.config.sim.films_itself
    assert not Mujoco().films_itself


@pytest.mark.usefixtures("camera")
def test_engines_without_cameras_and_machines_that_cannot_draw_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(ConfigError, match="the sensor has a camera, which sim=planar lacks"):
        FlipperEnv("flat", sim={"engine": "plain"}, perception="camera").reset(seed=1)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(RequestError, match="has neither EGL nor OSMesa: on Debian"):
        FlipperEnv("flat", sim="mujoco", perception="camera").reset(seed=1)
