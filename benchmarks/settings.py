"""The sizes of the developers' benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from pydantic import Field

from flipperctl.api import Engine
from flipperctl.bench.settings import COMMON_SMALL, Bench, CommonSettings, Suite
from flipperctl.errors import ConfigError
from flipperctl.sim.planar import Planar

MEASURES = ("physics", "accuracy", "lookahead", "lidar", "updates", "solve", "startup")
FAMILIES = (
    *("step", "stair", "building_stair", "ramp", "uplift"),
    *("gap", "wave", "rubble", "pallet", "plum"),
)
"""Terrains of the generalist's training, for benchmarks over all kinds of ground."""
MISSING = "stable-baselines3 is not installed; install flipperctl[bench]"
"""Why a comparison with another learner was not made."""

SMALL: Mapping[str, Any] = {
    **COMMON_SMALL,
    "episodes": 1,
    "families": 1,
    "starts": 1,
    "seeds": 1,
    "limit": 2.0,
    "validate_every": 100,
    "validation_episodes": 2,
    "commands": 1,
}
"""Values that replace the defaults with ``--small``, for a check that takes seconds."""


class BenchmarkSettings(CommonSettings):
    """The sizes of the benchmarks."""

    episodes: int = Field(
        4,
        ge=1,
        le=1000,
        description="physics, lidar: episodes per round; lookahead: episodes per terrain and "
        "controller whose decisions are predicted [-]",
    )
    starts: int = Field(
        20, ge=1, le=10_000, description="accuracy: starts per scene, episodes per terrain [-]"
    )
    families: int = Field(
        len(FAMILIES),
        ge=1,
        le=len(FAMILIES),
        description=f"accuracy, lookahead: terrains, the first of {', '.join(FAMILIES)} [-]",
    )
    seeds: int = Field(5, ge=1, le=100, description="solve: seeds per contestant [-]")
    limit: float = Field(600.0, gt=0, le=86_400, description="solve: time limit of a run [s]")
    validate_every: int = Field(
        1000, ge=1, le=1_000_000, description="solve: decisions between validations [-]"
    )
    validation_episodes: int = Field(
        100,
        ge=1,
        le=10_000,
        description="solve: episodes per validation, which must all succeed [-]",
    )
    in_a_row: int = Field(3, ge=1, le=100, description="solve: consecutive such validations [-]")
    commands: int = Field(
        100, ge=1, le=100, description="startup: largest number of commands, in help order [-]"
    )


Benchmark: TypeAlias = Bench[BenchmarkSettings]
"""Inputs of a benchmark."""

SUITE = Suite("benchmarks", MEASURES, BenchmarkSettings, SMALL)


def planar(chosen: Engine) -> Planar:
    """Return the engine if it is the planar one.

    Raises:
        ConfigError: another engine was chosen.
    """
    if not isinstance(chosen, Planar):
        raise ConfigError(f"sim: this is measured with sim=planar only; got {chosen.plugin_name}")
    return chosen
