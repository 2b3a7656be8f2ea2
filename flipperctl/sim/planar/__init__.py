"""The planar engine and sensor; importing this package registers both as ``planar``.

Placing a robot imports pymunk and numba.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import SAMPLE_PERIOD, Engine, Profile, Robot, Start, World, engine
from flipperctl.sim.planar.sensing import PlanarSensor, TerrainSensor

__all__ = ["Planar", "PlanarSensor", "TerrainSensor"]


@engine("planar")
class Planar(Engine):
    """Simulates rigid bodies in the robot's side plane with pymunk (Chipmunk)."""

    substep: float = Field(
        0.005, gt=0.0004, le=0.01, description="time step; 0.01 is a whole multiple of it [s]"
    )
    iterations: int = Field(20, ge=1, le=200, description="solver iterations per substep [-]")
    gravity: float = Field(9.81, gt=0, le=30, description="downward acceleration [m/s²]")
    friction: float = Field(
        1.0,
        gt=0,
        le=10,
        description="friction between track and ground; not given in the paper [-]",
    )

    @model_validator(mode="after")
    def _divides_the_sample(self) -> Self:
        ratio = SAMPLE_PERIOD / self.substep
        if abs(ratio - round(ratio)) > 1e-9:
            raise ValueError("substep must divide 0.01 s, the sampling time of the pitch")
        return self

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
