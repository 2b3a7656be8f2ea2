"""The planar engine and sensor; importing this package registers both as ``planar``.

Placing a robot imports pymunk and numba.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import Engine, Profile, Robot, Start, World, engine
from flipperctl.sim.planar.sensing import PlanarSensor, TerrainSensor
from flipperctl.sim.planar.settings import PlanarSettings

__all__ = ["Planar", "PlanarSensor", "TerrainSensor"]


@engine("planar")
class Planar(PlanarSettings, Engine):
    """Simulates rigid bodies in the robot's side plane with pymunk (Chipmunk)."""

    def place(
        self, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
    ) -> World:
        """Return a new world for the episode, so that replays are equal bit for bit.

        It is deterministic and does not use ``rng``.
        """
        from flipperctl.sim.planar.world import PlanarWorld

        return PlanarWorld(profile, robot, self, start)

    def versions(self) -> dict[str, str]:
        """Return the version of pymunk, which affects the results."""
        import pymunk

        return {"pymunk": pymunk.version}
