"""The 3-D scene of one robot on its ground, as meshes of a viser server.

In: a profile, a robot, states and perceptions. Out: nodes below one name. Ground of the side plane
is drawn as a strip, with edges where its slope changes. World: x forward, y to the left, z up [m].
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Perception, Profile, RobotGeometry, RobotState
from flipperctl.api import candidate_angle as candidate
from flipperctl.sim.outline import capsule

WIDTH = 1.5
"""Width of a strip of ground [m]."""
_LEVEL = 4.0
"""Length of the level ground before and past the profile [m]."""
_DEPTH = 0.3
"""Depth of the strip below its lowest point [m]."""
_EDGE = math.radians(8)
"""Least change of slope at which an edge is drawn [rad]."""
_STEEP = math.radians(45)
"""Slope from which on ground has the colour of risers [rad]."""
_TRACK, _FLIPPER, _MAIN = 0.18, 0.266, 0.086
"""Width of every track, and middle of each flipper and main track beside the chassis [m]."""
_BESIDE = -WIDTH / 2
"""y of what is perceived, at the edge of the strip [m]."""
TREAD, RISER, EDGE = (214, 204, 188), (150, 135, 115), (60, 52, 44)
CHASSIS, FRONT, REAR, BODY = (0, 114, 178), (213, 94, 0), (0, 158, 115), (70, 80, 92)
HEIGHTS, HIGHEST, POINTS, RAY = (170, 68, 153), (221, 170, 210), (34, 34, 34), (204, 51, 17)

Mesh = tuple[FloatArray, NDArray[np.uint32]]
"""Vertices (V, 3) [m] and triangles (T, 3)."""
Quad = list[list[float]]
"""Four corners, x, y and z each [m]."""


def prism(outline: FloatArray, right: float, left: float) -> Mesh:
    """Return a convex outline (N, 2), x and z [m], extruded from y ``right`` to ``left``."""
    count = len(outline)
    vertices = np.concatenate(
        [np.insert(outline, 1, right, axis=1), np.insert(outline, 1, left, axis=1)]
    )
    at = np.arange(count)
    after = (at + 1) % count
    sides = np.concatenate(
        [np.stack([at, at + count, after], 1), np.stack([after, at + count, after + count], 1)]
    )
    fan = np.stack([np.zeros(count - 2, int), at[1:-1], at[2:]], 1)
    faces = np.concatenate([sides, fan, fan[:, ::-1] + count])
    return vertices, faces.astype(np.uint32)


def strip(line: FloatArray, width: float = WIDTH) -> tuple[Mesh, Mesh, FloatArray]:
    """Return treads, risers with the cut through the ground, and edges of a ground line (V, 2).

    Edges are (E, 2, 3) [m]: across the strip where the slope changes, and along its borders.
    """
    run, rise = np.diff(line, axis=0).T
    slopes = np.arctan2(rise, run)
    right, left = -width / 2, width / 2
    flat: list[Quad] = []
    steep: list[Quad] = []
    for a, b, slope in zip(line[:-1], line[1:], slopes, strict=True):
        quad = [[a[0], right, a[1]], [b[0], right, b[1]], [b[0], left, b[1]], [a[0], left, a[1]]]
        (steep if abs(slope) > _STEEP else flat).append(quad)
    low = float(line[:, 1].min()) - _DEPTH
    for y in (right, left):
        for a, b in pairwise(line):
            if b[0] > a[0]:
                steep.append([[a[0], y, low], [b[0], y, low], [b[0], y, b[1]], [a[0], y, a[1]]])
    bends = np.flatnonzero(np.abs(np.diff(slopes)) > _EDGE) + 1
    across = [[[x, right, z], [x, left, z]] for x, z in line[bends]]
    along = [[[a[0], y, a[1]], [b[0], y, b[1]]] for y in (right, left) for a, b in pairwise(line)]
    return _quads(flat), _quads(steep), np.array(across + along)


def _quads(quads: list[Quad]) -> Mesh:
    vertices = np.array(quads, np.float64).reshape(-1, 3)
    first = 4 * np.arange(len(quads))[:, None]
    faces = np.concatenate([first + np.array(three) for three in ((0, 1, 2), (0, 2, 3))])
    return vertices, faces.astype(np.uint32)


class LiveScene:
    """Nodes of one lane; what lies below ``name`` moves with the lane's place beside others."""

    def __init__(self, scene: Any, name: str, side: float) -> None:
        """``scene``: ``viser.SceneApi``; ``side``: y of the lane's middle [m]."""
        self._scene, self._name, self._side = scene, name, side
        self._robot: RobotGeometry | None = None
        self._root = scene.add_frame(name, show_axes=False, position=(0.0, side, 0.0))
        self._parts: dict[str, Any] = {}

    def remove(self) -> None:
        """Remove everything below the name."""
        self._root.remove()

    def begin(self, profile: Profile, robot: RobotGeometry, finish: float, label: str) -> None:
        """Show the ground, a robot at rest and the finish line [m] of a new episode."""
        line = profile.extended(_LEVEL, _LEVEL)
        treads, risers, edges = strip(line)
        self._mesh("ground/treads", treads, TREAD)
        if len(risers[0]):
            self._mesh("ground/risers", risers, RISER)
        self._lines("ground/edges", edges, EDGE, 2.0)
        z = profile.height(finish)
        gate = [[[finish, y, z], [finish, y, z + 0.6]] for y in (-WIDTH / 2, WIDTH / 2)]
        gate.append([[finish, -WIDTH / 2, z + 0.01], [finish, WIDTH / 2, z + 0.01]])
        self._lines("finish", np.array(gate), REAR, 4.0)
        self._build(robot)
        self._scene.add_label(f"{self._name}/chassis/label", label, position=(0.0, 0.0, 0.5))

    def _build(self, robot: RobotGeometry) -> None:
        self._robot = robot
        half, reach, radius = robot.hinge_offset, robot.flipper_axle, robot.track_radius
        self._frame("chassis")
        main = capsule((-half, 0.0), (half, 0.0), radius)
        low, high, end = -0.05 * radius, 1.25 * radius, 0.7 * half
        body = np.array([[-end, low], [end, low], [end, high], [-end, high]])
        inner = max(0.02, _MAIN - _TRACK / 2)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            near, far = sorted((sign * inner, sign * (_MAIN + _TRACK / 2)))
            self._mesh(f"chassis/main_{side}", prism(main, near, far), CHASSIS)
        self._mesh("chassis/body", prism(body, -_MAIN, _MAIN), BODY)
        for name, x, colour in (("front", half, FRONT), ("rear", -half, REAR)):
            tip = reach if name == "front" else -reach
            outline = capsule((min(0.0, tip), 0.0), (max(0.0, tip), 0.0), radius)
            self._frame(f"chassis/{name}", (x, 0.0, 0.0))
            for side, sign in (("left", 1.0), ("right", -1.0)):
                near, far = sorted(sign * (_FLIPPER + s * _TRACK / 2) for s in (-1, 1))
                self._mesh(f"chassis/{name}/{side}", prism(outline, near, far), colour)

    def show(self, state: RobotState) -> None:
        """Move the robot."""
        x, z = state.position.tolist()
        chassis = self._parts["chassis"]
        chassis.position = (x, state.side, z)
        chassis.wxyz = _quaternion(rotation(state))
        # A flipper that is raised by θ turns against the y axis in front, and with it at the rear.
        self._parts["chassis/front"].wxyz = _about_y(-state.front)
        self._parts["chassis/rear"].wxyz = _about_y(state.rear)

    def perceive(self, p: Perception, state: RobotState) -> None:
        """Show what the policy perceived in a state: heights, points and the candidate angle."""
        assert self._robot is not None  # ``begin`` was called
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
                    np.stack([edges[:-1], np.full(bins, _BESIDE - 0.02), z], 1),
                    np.stack([edges[1:], np.full(bins, _BESIDE - 0.02), z], 1),
                ],
                axis=1,
            )
            self._lines(f"perceived/{name}", bars, colour, thick)
        cloud = np.insert(p.points + place, 1, _BESIDE - 0.01, axis=1)
        self._scene.add_point_cloud(
            f"{self._name}/perceived/points",
            cloud.astype(np.float32),
            POINTS,
            point_size=0.018,
            point_shape="circle",
        )
        ahead = np.array([math.cos(state.pitch), math.sin(state.pitch)])
        hinge = place + self._robot.hinge_offset * ahead
        angle = state.pitch + candidate(p.points, p.pitch, self._robot)
        tip = hinge + 0.6 * np.array([math.cos(angle), math.sin(angle)])
        ray = np.insert(np.stack([hinge, tip]), 1, -_FLIPPER - _TRACK / 2 - 0.02, axis=1)
        self._lines("perceived/candidate", ray[None], RAY, 3.0)

    def _frame(self, name: str, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self._parts[name] = self._scene.add_frame(
            f"{self._name}/{name}", show_axes=False, position=position
        )

    def _mesh(self, name: str, mesh: Mesh, colour: tuple[int, int, int]) -> None:
        vertices, faces = mesh
        self._scene.add_mesh_simple(
            f"{self._name}/{name}", vertices.astype(np.float32), faces, color=colour,
            flat_shading=True, side="double",
        )  # fmt: skip

    def _lines(
        self, name: str, points: FloatArray, colour: tuple[int, int, int], thick: float
    ) -> None:
        self._scene.add_line_segments(
            f"{self._name}/{name}", points.astype(np.float32), colour, thickness=thick,
            thickness_units="screen",
        )  # fmt: skip


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
