"""The fields of ``planner``: the settings of the search for the best trajectory of a scene."""

from __future__ import annotations

from pydantic import Field

from flipperctl.api import Settings


class PlannerSettings(Settings):
    """Size of the search, and the cost weight of pitch variation."""

    width: int = Field(
        40, ge=1, le=10_000, description="beam width: nodes expanded in each distance bin [-]"
    )
    smoothness: float = Field(
        30.0, ge=0, le=1000, description="cost weight of pitch variation [s/rad]"
    )
    budget: int = Field(
        200_000,
        ge=1,
        le=100_000_000,
        description="largest number of predicted decisions in the searches of an episode [-]",
    )
    stretch: float = Field(
        0.12, gt=0.001, le=1, description="length of a distance bin, in which nodes compete [m]"
    )
    cell: float = Field(
        0.02,
        gt=0.0001,
        le=1,
        description="nodes closer than this in position and pitch, with equal flipper angles, are "
        "merged into the cheapest [m, rad]",
    )
    policy: str = Field(
        "",
        description="a run, a checkpoint, an .onnx file or a shipped policy whose trajectory the "
        "search also starts from; empty: none [-]",
    )
