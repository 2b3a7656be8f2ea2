"""The fields of ``sim=planar``."""

from __future__ import annotations

from pydantic import Field, model_validator

from flipperctl.api import SAMPLE_PERIOD, Settings


class PlanarSettings(Settings):
    """Solver and friction of rigid bodies in the robot's side plane."""

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
    def _divides_the_sample(self) -> PlanarSettings:
        ratio = SAMPLE_PERIOD / self.substep
        if abs(ratio - round(ratio)) > 1e-9:
            raise ValueError("substep must divide 0.01 s, the sampling time of the pitch")
        return self
