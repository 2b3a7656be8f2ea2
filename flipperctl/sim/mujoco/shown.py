"""Pictures of a MuJoCo world: the model that they show, and the cameras.

In: the robot, its ground and its pose. Out: arrays of pixels, drawn without a window through EGL,
on a GPU or in software, or OSMesa, in software. The model that is shown has the joints and the
cameras of the simulated one, so that what is drawn does not affect what is simulated.
"""

from __future__ import annotations

import ctypes.util
import math
import os
from collections.abc import Sequence
from importlib import import_module
from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from flipperctl.api import CameraImage, FloatArray, Profile, Robot, View
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.sim.mujoco.appearance import (
    GROUSER,
    SKY,
    SUN,
    Mesh,
    ground_meshes,
    grousers,
    profile_line,
    robot_meshes,
    tracks,
)
from flipperctl.sim.mujoco.ground import Strip
from flipperctl.sim.mujoco.model import SCENERY, rgba, specify
from flipperctl.sim.mujoco.settings import MujocoSettings

NEAR, FAR = 0.02, 8000.0
"""Distances of the nearest and the farthest plane that is drawn [m].

The distance at which shadows begin is a fraction of the latter; with 400 m, ground is speckled.
"""
RIGHT, OUTSIDE, _SIMULATED = 3, 4, 5
"""Groups of what is at the robot's right, of what only pictures from outside show, and of the
simulated shapes, which MuJoCo does not draw by default [-]."""
_LARGEST = 1920, 1080  # width and height of the largest picture [pixels]
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
"""Name in ``MUJOCO_GL`` → system library, in the order in which they are tried."""
_INSTALL = "on Debian, apt install libegl1 libgl1-mesa-dri libopengl0, or libosmesa6"
_MOST_GEOMS = 2000
_SKY_DEPTH = 0.6
"""MuJoCo draws the sky at 0.7 of the distance of its farthest plane."""
_DISTANCE, _AZIMUTH, _ELEVATION = 4.2, 72.0, -14.0  # of the camera from the robot [m], [°], [°]
_FARTHEST = 7.0
"""Largest distance of a camera that stands still and shows all of the course [m]."""
_LEVEL = 1.0
"""Level ground on both sides of the profile that belongs to the course [m]."""
_ANGLE = 26.0  # vertical angle of view of the camera outside [°]
_BESIDE = 0.35
"""Ground to the right of the tracks that pictures from outside show; it is cut there [m]."""
_WHITE = (1.0, 1.0, 1.0)


class Shown:
    """What pictures of one episode show."""

    def __init__(
        self,
        profile: Profile,
        robot: Robot,
        sim: MujocoSettings,
        strips: Sequence[Strip],
        simulated: Any,
    ) -> None:
        """Build the model; the ``simulated`` one has the scenery."""
        self._robot, self._tracks = robot, list(tracks(robot, sim))
        # The robot has the joints of the engine's model; meshes cover its simulated shapes.
        spec = specify((), robot, sim)
        for geom in spec.geoms:
            geom.group = _SIMULATED
        set_looks(spec)
        for body, mesh in robot_meshes(robot, sim):
            _add(spec, body, mesh)
        # The bars of the belts, which ``pose`` moves
        for number, track in enumerate(self._tracks):
            for at in range(len(grousers(track, robot, 0.0)[0])):
                spec.body(track.body).add_geom(
                    name=f"grouser {number} {at}",
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=[1.0, (track.low + track.high) / 2, 1.0],
                    quat=[0.6, 0.0, 0.8, 0.0],  # with 1, 0, 0, 0, MuJoCo would ignore later ones
                    size=[GROUSER[0] / 2, 0.49 * (track.high - track.low), GROUSER[1] / 2],
                    rgba=rgba(GROUSER[2]),
                )
        # The ground is cut to the right of the tracks, where the camera outside looks from.
        wide = max(abs(y) for strip in strips for y in strip[:2])
        cut = -min(sim.flipper_offset + sim.track_width / 2 + sim.offset + _BESIDE, wide)
        for low, high, group in ((cut, wide, 0), (-wide, cut, RIGHT)):
            for mesh in ground_meshes(strips, low, high):
                _add(spec, "world", mesh.slanted(sim.slant), group)
        _add(spec, "world", profile_line(strips, cut).slanted(sim.slant), OUTSIDE)
        # Walls and posts stand where they are in the simulated model.
        for index in range(simulated.ngeom):
            geom = simulated.geom(index)
            if simulated.body(geom.bodyid[0]).name == SCENERY:
                looks = {"rgba": geom.rgba, "group": RIGHT if geom.pos[1] < 0 else 0}
                spec.worldbody.add_geom(type=geom.type[0], pos=geom.pos, size=geom.size, **looks)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        # The course: where the robot's centre drives, and the box of what it may fill there
        self.course = profile.start - _LEVEL, profile.end + _LEVEL
        low, high = self.course[0] - robot.reach, self.course[1] + robot.reach
        points = np.concatenate([strip.line for strip in strips])
        heights = points[(points[:, 0] >= low) & (points[:, 0] <= high), 1]
        half = sim.flipper_offset + sim.track_width / 2
        self.box = np.array(
            [[low, -half, heights.min()], [high, half, heights.max() + robot.reach]]
        )

    def pose(self, pose: FloatArray, travel: float) -> None:
        """Show a ``pose`` (``qpos``), with belts that have run a distance [m]."""
        model, data = self.model, self.data
        # Bars run along their belts.
        for number, track in enumerate(self._tracks):
            places, slopes = grousers(track, self._robot, travel)
            first = model.geom(f"grouser {number} 0").id
            bars = slice(first, first + len(places))
            model.geom_pos[bars, ::2] = places
            model.geom_quat[bars, ::2] = np.column_stack([np.cos(slopes / 2), -np.sin(slopes / 2)])
        # These are the parts of MuJoCo's forward pass that a picture needs.
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)


def _add(spec: Any, body: str, mesh: Mesh, group: int = 0) -> None:
    """Add a mesh to a body, with flat faces."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    added = spec.add_mesh(
        name=f"mesh {len(spec.meshes)}",
        uservert=mesh.triangles.ravel(),
        usernormal=np.repeat(normals, 3, axis=0).ravel(),
        userface=np.arange(3 * len(normals)),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    # MuJoCo computes the convex hull of what may collide, which flat meshes have not.
    looks = {"rgba": rgba(mesh.colour), "group": group, "contype": 0, "conaffinity": 0}
    geom = spec.body(body).add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=added.name, **looks)
    if hasattr(geom, "castshadow"):  # MuJoCo has it since version 4
        geom.castshadow = mesh.shades


def set_looks(spec: Any) -> None:
    """Set lights and sky of a scene."""
    spec.stat.extent = 1.0  # the unit of the following distances [m]
    spec.visual.map.znear, spec.visual.map.zfar, spec.visual.map.shadowclip = NEAR, FAR, 1.6
    spec.visual.global_.fovy = _ANGLE
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 2048, 4
    light = spec.visual.headlight
    light.ambient, light.diffuse, light.specular = (np.multiply(k, _WHITE) for k in (0.55, 0.15, 0))
    spec.body("chassis").add_light(
        pos=[0.0, 0.0, 3.0],
        dir=SUN,
        diffuse=np.multiply(0.45, _WHITE),
        specular=np.multiply(0.1, _WHITE),
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=True,
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=rgba(SKY)[:3],
        rgb2=rgba(SKY)[:3],
        width=64,
        height=384,
    )


class Camera:
    """A camera at the robot's right, a little behind, and those on the robot.

    It stands still while the robot is on a course that it can show whole; else it follows.
    """

    def __init__(self, shown: Shown, width: int, height: int) -> None:
        """Prepare pictures of ``width`` × ``height`` pixels."""
        if not (0 < width <= _LARGEST[0] and 0 < height <= _LARGEST[1]):
            raise RequestError(
                f"a picture of {width} × {height} pixels; at most {_LARGEST[0]} × {_LARGEST[1]} "
                "are allowed"
            )
        self._shown = shown
        self._view = mujoco.MjrRect(0, 0, width, height)
        # An OpenGL context must be current before MuJoCo builds its own on it.
        self._gl = _context(width, height)
        self._gl.make_current()
        shown.model.vis.global_.offwidth, shown.model.vis.global_.offheight = width, height
        scale = mujoco.mjtFontScale.mjFONTSCALE_100.value
        self._context = mujoco.MjrContext(shown.model, scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value  # more precise
        self._scene = mujoco.MjvScene(shown.model, maxgeom=_MOST_GEOMS)
        # The camera outside keeps its distance and its angles.
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = _AZIMUTH, _ELEVATION
        self._place, distance = _framing(shown.box, width / height)
        self._follows = distance > _FARTHEST
        self._camera.distance = _DISTANCE if self._follows else distance

    def draw(self) -> NDArray[np.uint8]:
        """Return a picture from outside, (H, W, 3)."""
        robot = self._shown.data.qpos[:3]
        beside = robot[0] - np.clip(robot[0], *self._shown.course), 0.0, 0.0
        self._camera.lookat[:] = robot if self._follows else self._place + beside
        return self._rendered(self._camera, hidden=RIGHT).pixels

    def look(self, view: View) -> CameraImage:
        """Return what a camera on the robot shows."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        camera.fixedcamid = self._shown.model.camera(view).id
        return self._rendered(camera, hidden=OUTSIDE)

    def _rendered(self, camera: Any, *, hidden: int) -> CameraImage:
        """Return a picture without one group of shapes."""
        # Pictures from outside lack what would hide the robot; cameras on the robot see it.
        options = mujoco.MjvOption()
        options.geomgroup[[RIGHT, OUTSIDE]] = True
        options.geomgroup[hidden] = False
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        what = self._shown.model, self._shown.data, options, None, camera, everything
        mujoco.mjv_updateScene(*what, self._scene)
        # Another camera may have made its context current since the last picture.
        self._gl.make_current()
        pixels = np.empty((self._view.height, self._view.width, 3), np.uint8)
        buffer = np.empty((self._view.height, self._view.width), np.float32)
        mujoco.mjr_render(self._view, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, buffer, self._view, self._context)
        # From 1 at the nearest plane to 0 at the farthest; OpenGL begins at the bottom.
        depth = NEAR * FAR / (buffer[::-1].astype(np.float64) * (FAR - NEAR) + NEAR)
        depth[depth >= _SKY_DEPTH * FAR] = np.inf
        return CameraImage(pixels[::-1].copy(), depth.astype(np.float32))


def _framing(box: FloatArray, aspect: float) -> tuple[FloatArray, float]:
    """Return the place (x, y, z) to look at from outside and the least distance that shows a box.

    ``box``: lowest and highest x, y, z, (2, 3) [m]; ``aspect``: width per height of a picture [-].
    """
    azimuth, elevation = math.radians(_AZIMUTH), math.radians(_ELEVATION)
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    right, ahead = np.array([level[1], -level[0], 0.0]), math.cos(elevation) * level
    ahead[2] = math.sin(elevation)
    tall = math.tan(math.radians(_ANGLE) / 2)
    wide = aspect * tall
    # The place is where the left and the right corners need the same distance.
    place = box.mean(axis=0)
    corners = np.array(list(product(*box.T))) - place  # (8, 3) [m]
    aside, deep = corners @ right / wide, corners @ ahead
    shift = ((aside - deep).max() - (-aside - deep).max()) * wide / (2 * right[0])
    place[0] += shift
    corners[:, 0] -= shift
    beside = np.maximum(
        np.abs(corners @ right) / wide, np.abs(corners @ np.cross(right, ahead)) / tall
    )
    return place, float((beside - corners @ ahead).max())


def _context(width: int, height: int) -> Any:
    """Return an OpenGL context without a window."""
    # MUJOCO_GL decides; without it, the first library that is installed does.
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    names = [wanted] if wanted in _LIBRARIES else list(_LIBRARIES)
    installed = [name for name in names if ctypes.util.find_library(_LIBRARIES[name])]
    if not installed:
        libraries = " nor ".join(_LIBRARIES[name] for name in names)
        raise RequestError(
            f"pictures of sim=mujoco need a library that draws without a window; this machine has "
            f"{'neither ' if len(names) > 1 else 'no '}{libraries}: {_INSTALL}"
        )
    try:
        return import_module(f"mujoco.{installed[0]}").GLContext(width, height)
    except Exception as error:  # the drivers' errors have no common class
        raise FlipperctlError(
            f"pictures of sim=mujoco: {_LIBRARIES[installed[0]]} cannot draw on this machine "
            f"({' '.join(str(error).split())[:200]}); try the other library with "
            f"MUJOCO_GL={'osmesa' if installed[0] == 'egl' else 'egl'}, or: {_INSTALL}"
        ) from error
