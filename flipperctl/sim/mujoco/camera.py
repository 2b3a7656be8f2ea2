"""Pictures of a MuJoCo world, drawn offscreen through EGL or OSMesa.

In: what is shown, and the robot's pose. Out: arrays of pixels. A window system is not needed; EGL
draws on a GPU or in software, OSMesa in software.
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
from flipperctl.sim.mujoco.shown import FAR, NEAR, OUTSIDE, RIGHT, Shown

_LARGEST = 1920, 1080  # width and height of the largest picture [pixels]
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
"""Name in ``MUJOCO_GL`` → system library, in the order in which they are tried."""
_INSTALL = "on Debian, apt install libegl1 libegl-mesa0, or libosmesa6"
_MOST_GEOMS = 2000
_SKY = 0.6
"""MuJoCo draws the sky at 0.7 of the distance of its farthest plane."""
_DISTANCE, _AZIMUTH, _ELEVATION = 4.2, 72.0, -14.0  # of the camera from the robot [m], [°], [°]


class Camera:
    """A camera that follows the robot at its right, a little behind, and those on the robot."""

    def __init__(self, shown: Shown, width: int, height: int) -> None:
        """Prepare pictures of ``width`` × ``height`` pixels."""
        if not (0 < width <= _LARGEST[0] and 0 < height <= _LARGEST[1]):
            raise RequestError(
                f"a picture of {width} × {height} pixels; at most {_LARGEST[0]} × {_LARGEST[1]} "
                "are allowed"
            )
        self._shown = shown
        self._view = mujoco.MjrRect(0, 0, width, height)
        self._gl = _context(width, height)
        self._gl.make_current()
        shown.model.vis.global_.offwidth, shown.model.vis.global_.offheight = width, height
        scale = mujoco.mjtFontScale.mjFONTSCALE_100.value
        self._context = mujoco.MjrContext(shown.model, scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value  # more precise
        self._scene = mujoco.MjvScene(shown.model, maxgeom=_MOST_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._camera.distance = _DISTANCE
        self._camera.azimuth, self._camera.elevation = _AZIMUTH, _ELEVATION

    def draw(self) -> NDArray[np.uint8]:
        """Return a picture from outside, (H, W, 3)."""
        self._camera.lookat[:] = self._shown.data.qpos[:3]
        return self._rendered(self._camera, hidden=RIGHT).pixels

    def look(self, view: View) -> CameraImage:
        """Return what a camera on the robot shows."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        camera.fixedcamid = self._shown.model.camera(view).id
        return self._rendered(camera, hidden=OUTSIDE)

    def _rendered(self, camera: Any, *, hidden: int) -> CameraImage:
        """Return a picture without one group of shapes."""
        options = mujoco.MjvOption()
        options.geomgroup[[RIGHT, OUTSIDE]] = True
        options.geomgroup[hidden] = False
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        what = self._shown.model, self._shown.data, options, None, camera, everything
        mujoco.mjv_updateScene(*what, self._scene)
        self._gl.make_current()
        pixels = np.empty((self._view.height, self._view.width, 3), np.uint8)
        buffer = np.empty((self._view.height, self._view.width), np.float32)
        mujoco.mjr_render(self._view, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, buffer, self._view, self._context)
        # From 1 at the nearest plane to 0 at the farthest; OpenGL begins at the bottom.
        depth = NEAR * FAR / (buffer[::-1].astype(np.float64) * (FAR - NEAR) + NEAR)
        depth[depth >= _SKY * FAR] = np.inf
        return CameraImage(pixels[::-1].copy(), depth.astype(np.float32))


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
