"""The 3-D engine; importing this package registers it as ``mujoco``.

Placing a robot imports the library MuJoCo, which the extra ``flipperctl[mujoco]`` installs.
"""

from __future__ import annotations

import os
from typing import ClassVar

import numpy as np

from flipperctl.api import Engine, Profile, Robot, Start, World, engine
from flipperctl.core.targets import Flippers
from flipperctl.errors import RequestError, missing_extra
from flipperctl.sim.mujoco.settings import MujocoSettings

__all__ = ["Mujoco"]


@engine("mujoco")
class Mujoco(MujocoSettings, Engine):
    """Simulates the robot in 3-D with MuJoCo, on the profile extruded sideways.

    If the profile has a surface, the robot drives over the surface instead.
    """

    flippers: ClassVar[tuple[Flippers, ...]] = ("pairs", "four")
    without_effect: ClassVar[frozenset[str]] = frozenset({"view"})
    added: ClassVar[frozenset[str]] = frozenset({"stagger", "oblique", "mirrored"})

    def place(
        self, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
    ) -> World:
        """Return a new world for the episode, so that replays are equal bit for bit.

        Yaw, offset and roughness are sampled from ``rng``.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            RequestError: the environment names an OpenGL library that is not installed.
            TerrainError: the ground needs too many pieces, or is unknown where the robot drives.
        """
        # The module of the world imports MuJoCo at its head; here its absence can be explained.
        try:
            import mujoco  # noqa: F401
        except ImportError as error:
            raise missing_extra("sim=mujoco", "mujoco") from error
        except (AttributeError, RuntimeError) as error:  # MUJOCO_GL's library is missing or unknown
            raise RequestError(
                f"sim=mujoco: MuJoCo does not import with MUJOCO_GL={os.environ.get('MUJOCO_GL')}, "
                "for which this machine has no library; unset it or set it to egl"
            ) from error
        from flipperctl.sim.mujoco.world import MujocoWorld

        return MujocoWorld(profile, robot, self, start, rng)

    def versions(self) -> dict[str, str]:
        """Return the version of MuJoCo, which affects the results."""
        from importlib.metadata import version

        return {"mujoco": version("mujoco")}
