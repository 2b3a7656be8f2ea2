"""The 3-D scene of one robot on its ground, as meshes of a viser server.

In: a profile, a robot, states and perceptions. Out: nodes below one name. Ground of the side plane
is drawn as a strip, with edges where its slope changes. World: x forward, y to the left, z up [m].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Perception, Profile, RobotGeometry, RobotState
from flipperctl.api import candidate_angle as candidate
from flipperctl.sim.mujoco.appearance import Mesh, ground_meshes, robot_meshes
from flipperctl.sim.mujoco.ground import Strip
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.outline import REAR

WIDTH = 1.5
"""Width of a strip of ground [m]."""
_LEVEL = 4.0
"""Length of the level ground before and past the profile [m]."""
_TRACKS = MujocoSettings()
"""Where the tracks lie beside the chassis."""
_BESIDE = -WIDTH / 2 - 0.02
"""y of what is perceived, beside the strip [m]."""
HEIGHTS, HIGHEST, INK, RAY = "#AA4499", "#DDAAD2", "#222222", "#CC3311"
PLAN, MAP = "#DDAA33", "#33BBEE"


class LiveScene:
    """Nodes of one lane; what lies below ``name`` moves with the lane's place beside others."""

    def __init__(self, scene: Any, name: str, side: float) -> None:
        """``scene``: ``viser.SceneApi``; ``side``: y of the lane's middle [m]."""
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

    def begin(self, profile: Profile, robot: RobotGeometry, finish: float, label: str) -> None:
        """Show the ground, a robot at rest and the finish line [m] of a new episode."""
        self.perceived.remove()  # of the episode before
        self.perceived = self._add_perceived()
        ground = Strip(-WIDTH / 2, WIDTH / 2, profile.extended(_LEVEL, _LEVEL))
        for mesh in ground_meshes([ground], -WIDTH / 2, WIDTH / 2):
            self._mesh(f"ground/{mesh.colour[1:]}", mesh)
        # The finish: two posts and a line on the ground
        z = profile.height(finish)
        gate = [[[finish, y, z], [finish, y, z + 0.6]] for y in (-WIDTH / 2, WIDTH / 2)]
        gate.append([[finish, -WIDTH / 2, z + 0.01], [finish, WIDTH / 2, z + 0.01]])
        self._lines("finish", np.array(gate), REAR, 4.0)
        self._build(robot)
        self._scene.add_label(f"{self._name}/chassis/label", label, position=(0.0, 0.0, 0.5))

    def _build(self, robot: RobotGeometry) -> None:
        self._robot = robot
        half = robot.hinge_offset
        for end, x in (("chassis", 0.0), ("front", half), ("rear", -half)):
            path = end if end == "chassis" else f"chassis/{end}"
            self._parts[end] = self._scene.add_frame(
                f"{self._name}/{path}", show_axes=False, position=(x, 0.0, 0.0)
            )
        for number, (body, mesh) in enumerate(robot_meshes(robot, _TRACKS)):
            end, _, side = body.partition("_")
            y = {"left": 1, "right": -1, "": 0}[side] * _TRACKS.flipper_offset
            path = body if end == "chassis" else f"chassis/{end}"
            self._mesh(f"{path}/{number}", mesh, y)

    def show(self, state: RobotState) -> None:
        """Move the robot."""
        x, z = state.position.tolist()
        chassis = self._parts["chassis"]
        chassis.position = (x, state.side, z)
        chassis.wxyz = _quaternion(rotation(state))
        # A flipper that is raised by θ turns against the y axis in front, and with it at the rear.
        self._parts["front"].wxyz = _about_y(-state.front)
        self._parts["rear"].wxyz = _about_y(state.rear)

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

    def _mesh(self, name: str, mesh: Mesh, side: float = 0.0) -> None:
        corners = mesh.triangles.reshape(-1, 3).astype(np.float32)
        faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        self._scene.add_mesh_simple(
            f"{self._name}/{name}", corners, faces, color=rgb(mesh.colour), flat_shading=True,
            side="double", position=(0.0, side, 0.0),
        )  # fmt: skip

    def _lines(self, name: str, points: FloatArray, colour: str, thick: float) -> None:
        self._scene.add_line_segments(
            f"{self._name}/{name}", points.astype(np.float32), rgb(colour), thickness=thick,
            thickness_units="screen",
        )  # fmt: skip


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour of HTML, such as ``#0072B2``, as numbers."""
    red, green, blue = bytes.fromhex(colour[1:])
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
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(turn).as_quat().tolist()
    return w, x, y, z
