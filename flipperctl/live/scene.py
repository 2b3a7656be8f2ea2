"""The 3-D scene of live pages, in the colours and lights of films, as nodes of a viser server.

In: profiles, robots, states and perceptions. Out: a stage with sky, sun, floor and camera, and for
each robot a lane with its ground. Ground of the side plane is drawn as a strip, with edges where
its slope changes. World: x forward, y to the left, z up [m].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from flipperctl.api import FloatArray, Perception, Profile, RobotGeometry, RobotState
from flipperctl.api import candidate_angle as candidate
from flipperctl.core.targets import JOINTS, alike, angles_of
from flipperctl.sim.mujoco.appearance import (
    SKY,
    SUN,
    Mesh,
    ground_meshes,
    profile_line,
    robot_meshes,
)
from flipperctl.sim.mujoco.ground import Strip
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.outline import REAR

WIDTH = 1.5
"""Width of a strip of ground [m]."""
_BETWEEN = 0.35
"""Distance between the grounds of two lanes [m]."""
_LEVEL = 14.0
"""Length of the level ground before and past the profile, which ends in the haze [m]."""
_FLOOR = "#CBC5BA"
_WIDE = 20.0  # half the width of the floor [m]
_HAZE = 8.0, 15.0  # distance from the camera at which the haze begins, and is all that is seen [m]
_CLEARER = 1.4, 0.5  # by how much farther they are for each further lane [m]
_NAME = 1.8, 0.3
"""Where the name of a lane begins: x from its robot, and y [m]."""
_THIN = 0.02  # ground of a lane above the floor, at its lowest point [m]
_SKIES = {False: ("#C3DAEE", SKY), True: ("#1C2530", "#252E39")}
"""Colours of the sky at its top and at the horizon, by whether the page is dark."""
_BAND = 0.1
"""Part of a picture's height in which the sky changes its colour, from its top [-]."""
_LIGHTS = {False: (3.9, 2.25), True: (2.3, 1.2)}
"""Light from all sides and of the sun, by whether the page is dark; by day, a face towards the sun
has its own colour."""
_ANGLE = math.radians(30)  # vertical angle of view
_AZIMUTH, _ELEVATION = math.radians(72), math.radians(16)  # of the camera, as in films
_TOWARDS = np.array(
    [*(math.cos(_ELEVATION) * np.array([math.cos(_AZIMUTH), math.sin(_AZIMUTH)])),
     -math.sin(_ELEVATION)]
)  # fmt: skip
"""Where the camera looks, (3,)."""
_DISTANCE, _FARTHER = 5.4, 1.3  # of the camera from one robot, and for each further lane [m]
_AHEAD, _ABOVE = 0.5, 0.1  # where the camera looks, seen from the robot [m]
_RISE = 0.05  # part of the robots' rise that the camera follows at each state [-]
_APART = 1.2  # difference of the robots' heights from which on they are shown from farther away [m]
_TRACKS = MujocoSettings()
"""Where the tracks lie beside the chassis."""
_BESIDE = -WIDTH / 2 - 0.02
"""y of what is perceived, beside the strip [m]."""
_BEFORE_CURVE = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]]
)
_AFTER_CURVE = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]]
)
"""Mixtures of red, green and blue before and after the curve of a browser's tone mapping."""
_PATH = {"chassis": "chassis", **{name: f"chassis/{name}" for name in JOINTS["four"]}}
"""Names of nodes by the robot's bodies."""
HEIGHTS, HIGHEST, INK, RAY = "#AA4499", "#DDAAD2", "#222222", "#CC3311"
PLAN, MAP = "#DDAA33", "#33BBEE"


@runtime_checkable
class _OnStrips(Protocol):
    """A world whose ground has strips, as that of ``sim=mujoco``."""

    strips: Sequence[Strip]
    sim: MujocoSettings


class Laid(NamedTuple):
    """The ground of an episode."""

    strips: Sequence[Strip]
    slant: float
    """How far it lies ahead for each metre to the left [-]."""

    @classmethod
    def of(cls, profile: Profile, world: object = None) -> Laid:
        """Return what an engine's world stands on; in the side plane, its profile."""
        if isinstance(world, _OnStrips):
            return cls(world.strips, world.sim.slant)
        return cls([Strip(-WIDTH / 2, WIDTH / 2, profile.extended(_LEVEL, _LEVEL))], 0.0)


class Stage:
    """What all lanes share: sky, lights and floor, and a camera that stands still.

    Ground moves below the robots instead: each stays at its place in the picture, beside the
    others, however far they are apart.
    """

    def __init__(self, server: Any) -> None:
        """``server``: a ``viser.ViserServer``, whose panel stays empty."""
        self._server, scene = server, server.scene
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.minimize()
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        # The sun alone casts shadows; pictures that surround a scene would grey its colours.
        scene.configure_environment_map(None)
        scene.configure_default_lights(enabled=False)
        self._lights = (
            scene.add_light_ambient("/ambient"),
            scene.add_light_directional(
                "/sun", cast_shadow=True, position=tuple(-10 * part for part in SUN)
            ),
        )
        self._world = scene.add_frame("/drive", show_axes=False)
        self._floor: Any = None
        self._heights: dict[LiveScene, float] = {}
        """z of each robot [m]."""
        self._height: float | None = None
        """z in the middle of the picture; None before the first state of an episode [m]."""
        self._dark, self._lanes = False, 1
        self.set_dark(False)
        self.look_at_lanes(1)

    def set_dark(self, dark: bool) -> None:
        """Show day or dusk."""
        scene = self._server.scene
        top, horizon = (np.array(rgb(colour)) for colour in _SKIES[dark])
        share = np.linspace(0, 1, 256)[:, None].clip(0, _BAND) / _BAND
        sky = ((1 - share) * top + share * horizon).round().astype(np.uint8)
        scene.set_background_image(np.repeat(sky[:, None], 2, axis=1), format="png")
        self._dark = dark
        self._add_haze()
        for light, intensity in zip(self._lights, _LIGHTS[dark], strict=True):
            light.intensity = intensity

    def _add_haze(self) -> None:
        """Hide where the ground ends, and no robot."""
        near, far = np.array(_HAZE) + (self._lanes - 1) * np.array(_CLEARER)
        # Colours of the haze are of linear light.
        red, green, blue = (255 * _linear(_SKIES[self._dark][1])).round().astype(int).tolist()
        self._server.scene.configure_fog(float(near), float(far), color=(red, green, blue))

    def set_shadows(self, shown: bool) -> None:
        """Show or hide shadows, which take a browser without a graphics card twice as long."""
        self._lights[1].cast_shadow = shown

    def look_at_lanes(self, count: int) -> None:
        """Turn the cameras of all browsers to ``count`` lanes."""
        self._lanes = count
        self._add_haze()
        middle = np.array([_AHEAD, (count - 1) / 2 * (WIDTH + _BETWEEN), _ABOVE])
        place = middle - (_DISTANCE + _FARTHER * (count - 1)) * _TOWARDS
        cameras = [client.camera for client in self._server.get_clients().values()]
        for camera in (self._server.initial_camera, *cameras):
            camera.position, camera.look_at = tuple(place), tuple(middle)
            camera.fov = _ANGLE

    def begin(self, grounds: Sequence[Laid]) -> float:
        """Lay the floor below the grounds of an episode; return its z [m]."""
        z = min(float(strip.line[:, 1].min()) for ground in grounds for strip in ground.strips)
        z -= _THIN
        corners = _WIDE * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        self._floor = self._server.scene.add_mesh_simple(
            "/floor", np.insert(corners, 2, z, axis=1).astype(np.float32),
            np.array([[0, 1, 2], [0, 2, 3]], np.uint32), color=_surface(_FLOOR), cast_shadow=False,
        )  # fmt: skip
        self._heights, self._height = {}, None
        return z

    def follow(self, robots: Sequence[tuple[LiveScene, RobotState]]) -> None:
        """Keep the robots that move, and those that have ended, in view."""
        for lane, state in robots:
            lane.follow(state)
            self._heights[lane] = float(state.position[1])
        heights = list(self._heights.values())
        middle = (min(heights) + max(heights)) / 2
        before = middle if self._height is None else self._height
        self._height = before + _RISE * (middle - before)
        # Robots on a stair and at its foot need a larger part of the world.
        apart = max(0.0, max(heights) - min(heights) - _APART)
        x, y, z = apart / (2 * math.tan(_ANGLE / 2)) * _TOWARDS
        self._world.position = (x, y, z - self._height)
        self._floor.position = (x, y, z - self._height)


class LiveScene:
    """Nodes of one lane; what lies below its name moves with its place beside others."""

    def __init__(self, scene: Any, lane: int = 0) -> None:
        """``scene``: ``viser.SceneApi``; ``lane``: number of lanes between it and the camera."""
        name, side = f"/drive/{lane}", lane * (WIDTH + _BETWEEN)
        self._scene, self._name, self._side = scene, name, side
        self._robot: RobotGeometry | None = None
        self._root = scene.add_frame(name, show_axes=False, position=(0.0, side, 0.0))
        self._parts: dict[str, Any] = {}
        self.perceived = self._add_perceived()
        """Frame of what is perceived, to hide it."""

    def _add_perceived(self) -> Any:
        return self._scene.add_frame(f"{self._name}/perceived", show_axes=False)

    def remove(self) -> None:
        """Remove everything below the name."""
        self._root.remove()

    def begin(
        self,
        profile: Profile,
        robot: RobotGeometry,
        finish: float,
        floor: float,
        label: str = "",
        ground: Laid | None = None,
    ) -> None:
        """Show a new episode: ground from the ``floor`` [m] up, a robot at rest, the finish [m].

        ``ground``: None is that of the profile.
        """
        self.perceived.remove()  # of the episode before
        self.perceived = self._add_perceived()
        strips, slant = Laid.of(profile) if ground is None else ground
        border = -WIDTH / 2
        deep = min(float(strip.line[:, 1].min()) for strip in strips) - floor
        for mesh in ground_meshes(strips, border, WIDTH / 2, deep):
            self._mesh(f"ground/{mesh.colour[1:]}", mesh.slanted(slant), shadow=False)
        self._mesh("ground/line", profile_line(strips, border).slanted(slant), shadow=False)
        # The finish: two posts and a line on the ground
        z = profile.height(finish)
        gate = [[[finish, y, z], [finish, y, z + 0.6]] for y in (-WIDTH / 2, WIDTH / 2)]
        gate.append([[finish, -WIDTH / 2, z + 0.01], [finish, WIDTH / 2, z + 0.01]])
        self._lines("finish", np.array(gate), REAR, 4.0)
        self._build(robot)
        self._profile = profile
        # The name lies on the ground ahead: above its robot it would hide those of farther lanes.
        # A frame moves, and the label in it stays as it is, as on the chassis before.
        self._label = self._scene.add_frame(f"{self._name}/label", show_axes=False)
        if label:
            self._scene.add_label(f"{self._name}/label/text", label, anchor="bottom-left")

    def follow(self, state: RobotState) -> None:
        """Move the lane so that its robot is at x = 0."""
        self._root.position = (-float(state.position[0]), self._side, 0.0)

    def _build(self, robot: RobotGeometry) -> None:
        self._robot = robot
        half, aside = robot.hinge_offset, _TRACKS.flipper_offset
        for body in ("chassis", *JOINTS["four"]):
            end, _, side = body.partition("_")
            place = {"front": half, "rear": -half}.get(end, 0.0)
            self._parts[body] = self._scene.add_frame(
                f"{self._name}/{_PATH[body]}", show_axes=False,
                position=(place, {"left": aside, "right": -aside}.get(side, 0.0), 0.0),
            )  # fmt: skip
        for number, (body, mesh) in enumerate(robot_meshes(robot, _TRACKS)):
            self._mesh(f"{_PATH[body]}/{number}", mesh)

    def show(self, state: RobotState) -> None:
        """Move the robot."""
        x, z = state.position.tolist()
        chassis = self._parts["chassis"]
        chassis.position = (x, state.side, z)
        chassis.wxyz = _quaternion(rotation(state))
        ahead = x + _NAME[0]
        self._label.position = (ahead, _NAME[1], self._profile.height(ahead))
        # A flipper that is raised by θ turns against the y axis in front, and with it at the rear.
        for name, angle in zip(JOINTS["four"], _four(angles_of(state)), strict=True):
            self._parts[name].wxyz = _about_y(angle if name.startswith("rear") else -angle)

    def perceive(self, p: Perception, state: RobotState, mapped: FloatArray | None = None) -> None:
        """Show what the policy perceived in a state: heights, points and the candidate angle.

        ``mapped``: points of its map, (P, 3) in frame L [m].
        """
        assert self._robot is not None  # ``begin`` was called
        # Heights of the bins, beside the strip of ground
        place = state.position
        width, bins = p.layout.bin_width, p.layout.bins
        edges = (np.arange(bins + 1) - bins / 2) * width + place[0]
        shown = [(p.observation[:bins], "heights", HEIGHTS, 5.0)]
        if p.layout.highest:
            shown.append((p.observation[bins : 2 * bins], "highest", HIGHEST, 3.0))
        for heights, name, colour, thick in shown:
            z = heights + place[1]
            bars = np.stack(
                [
                    np.stack([edges[:-1], np.full(bins, _BESIDE), z], 1),
                    np.stack([edges[1:], np.full(bins, _BESIDE), z], 1),
                ],
                axis=1,
            )
            self._lines(f"perceived/{name}", bars, colour, thick)
        # Sensed points, and those of a map, which lie to both sides of the line
        self._points("points", np.insert(p.points + place, 1, _BESIDE, axis=1), INK, 0.018)
        if mapped is not None:
            ahead = rotation(state)[:2, 0] / np.hypot(*rotation(state)[:2, 0])
            left = np.array([-ahead[1], ahead[0]])
            level = mapped[:, :1] * ahead + mapped[:, 1:2] * left + (place[0], state.side)
            self._points("map", np.column_stack([level, mapped[:, 2] + place[1]]), MAP, 0.012)
        # The candidate angle as a ray from the front hinge
        ahead = np.array([math.cos(state.pitch), math.sin(state.pitch)])
        hinge = place + self._robot.hinge_offset * ahead
        angle = state.pitch + candidate(p.points, p.pitch, self._robot)
        tip = hinge + 0.6 * np.array([math.cos(angle), math.sin(angle)])
        ray = np.insert(
            np.stack([hinge, tip]), 1, -_TRACKS.flipper_offset - _TRACKS.track_width, axis=1
        )
        self._lines("perceived/candidate", ray[None], RAY, 3.0)

    def plan(self, path: FloatArray, state: RobotState) -> None:
        """Show the places where a policy planned to be, from its place in a state, (K + 1, 2)."""
        places = np.insert(path + state.position, 1, _BESIDE, axis=1)
        self._lines("perceived/plan", np.stack([places[:-1], places[1:]], axis=1), PLAN, 4.0)

    def _points(self, name: str, points: FloatArray, colour: str, size: float) -> None:
        self._scene.add_point_cloud(
            f"{self._name}/perceived/{name}", points.astype(np.float32), rgb(colour),
            point_size=size, point_shape="circle",
        )  # fmt: skip

    def _mesh(self, name: str, mesh: Mesh, *, shadow: bool = True) -> None:
        corners = mesh.triangles.reshape(-1, 3).astype(np.float32)
        faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        self._scene.add_mesh_simple(
            f"{self._name}/{name}", corners, faces, color=_surface(mesh.colour), flat_shading=True,
            side="double", cast_shadow=shadow,
        )  # fmt: skip

    def _lines(self, name: str, points: FloatArray, colour: str, thick: float) -> None:
        self._scene.add_line_segments(
            f"{self._name}/{name}", points.astype(np.float32), rgb(colour), thickness=thick,
            thickness_units="screen",
        )  # fmt: skip


def _four(angles: Sequence[float]) -> Sequence[float]:
    return angles if len(angles) > 2 else alike(angles, 4)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour of HTML, such as ``#0072B2``, as numbers."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _linear(colour: str) -> FloatArray:
    """Return a colour of HTML in linear light, (3,), 0 to 1."""
    parts = np.array(rgb(colour)) / 255
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


def _surface(colour: str) -> tuple[int, int, int]:
    """Return the colour of a surface that a browser shows as ``colour`` in the sun of the day.

    Browsers map light by the filmic curve of ACES (Hill's fit, as in three.js), which makes it
    paler; this is the inverse of the curve.
    """
    y = np.linalg.solve(_AFTER_CURVE, _linear(colour))
    # y = (v² + a v - b) / (c v² + d v + e), solved for v
    a, b, c, d, e = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
    half = (a - d * y) / (2 * (1 - c * y))
    light = np.sqrt(half**2 + (b + e * y) / (1 - c * y)) - half
    around, sun = _LIGHTS[False]
    shining = (around - sun * SUN[2] / math.hypot(*SUN)) / math.pi
    parts = (0.6 * np.linalg.solve(_BEFORE_CURVE, light) / shining).clip(0, 1)
    shown = np.where(parts <= 0.0031308, 12.92 * parts, 1.055 * parts ** (1 / 2.4) - 0.055)
    red, green, blue = (255 * shown).round().astype(int).tolist()
    return red, green, blue


def rotation(state: RobotState) -> FloatArray:
    """Return the rotation from frame R to world, (3, 3)."""
    if state.orientation is not None:
        return state.orientation
    cos, sin = math.cos(state.pitch), math.sin(state.pitch)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def _about_y(angle: float) -> tuple[float, float, float, float]:
    return math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0


def _quaternion(turn: FloatArray) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of a rotation (3, 3)."""
    signs = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    w, x, y, z = np.sqrt((1 + signs @ np.diag(turn)).clip(0)) / 2
    axis = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    x, y, z = np.copysign((x, y, z), axis)
    return float(w), float(x), float(y), float(z)
