"""Pictures of a MuJoCo world, drawn offscreen through EGL or OSMesa.

In: a model and its data. Out: arrays of pixels. A window system is not needed; EGL draws on a GPU
or in software, OSMesa in software.
"""

from __future__ import annotations

import ctypes.util
import os
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from flipperctl.api import CameraImage, View
from flipperctl.errors import FlipperctlError, RequestError

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
"""Name in ``MUJOCO_GL`` → system library, in the order in which they are tried."""
_INSTALL = "on Debian, apt install libegl1 libegl-mesa0, or libosmesa6"
_MOST_GEOMS = 20_100
_SKY = 0.6
"""MuJoCo draws the sky at 0.7 of the distance of its farthest plane, which is kilometres away."""
_DISTANCE, _AZIMUTH, _ELEVATION = 2.6, 125.0, -18.0  # of the camera from the robot [m], [°], [°]


class Camera:
    """A camera that follows the robot from behind, at one side, and those on the robot."""

    def __init__(self, model: Any, width: int, height: int) -> None:
        """Prepare pictures of ``width`` × ``height`` pixels."""
        largest = model.vis.global_.offwidth, model.vis.global_.offheight
        if not (0 < width <= largest[0] and 0 < height <= largest[1]):
            raise RequestError(
                f"a picture of {width} × {height} pixels; at most {largest[0]} × {largest[1]} "
                "are allowed"
            )
        self._model = model
        self._view = mujoco.MjrRect(0, 0, width, height)
        self._gl = _context(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value  # more precise
        self._scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._camera, self._options = mujoco.MjvCamera(), mujoco.MjvOption()
        self._camera.distance = _DISTANCE
        self._camera.azimuth, self._camera.elevation = _AZIMUTH, _ELEVATION

    def draw(self, data: Any) -> NDArray[np.uint8]:
        """Return a picture of the current state from outside, (H, W, 3)."""
        self._camera.lookat[:] = data.qpos[:3]
        return self._rendered(data, self._camera).pixels

    def look(self, data: Any, view: View) -> CameraImage:
        """Return what a camera on the robot shows."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        camera.fixedcamid = self._model.camera(view).id
        return self._rendered(data, camera)

    def _rendered(self, data: Any, camera: Any) -> CameraImage:
        mujoco.mj_kinematics(self._model, data)  # ``mj_step`` does not update the bodies' poses
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_camlight(self._model, data)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        view = self._options, None, camera, everything, self._scene
        mujoco.mjv_updateScene(self._model, data, *view)
        self._gl.make_current()
        pixels = np.empty((self._view.height, self._view.width, 3), np.uint8)
        buffer = np.empty((self._view.height, self._view.width), np.float32)
        mujoco.mjr_render(self._view, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, buffer, self._view, self._context)
        extent, planes = self._model.stat.extent, self._model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        # From 1 at the nearest plane to 0 at the farthest; OpenGL begins at the bottom.
        depth = near * far / (buffer[::-1].astype(np.float64) * (far - near) + near)
        depth = np.where(depth < _SKY * far, depth, np.inf).astype(np.float32)
        return CameraImage(pixels[::-1].copy(), depth)


def _context(width: int, height: int) -> Any:
    """Return an OpenGL context without a window."""
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
