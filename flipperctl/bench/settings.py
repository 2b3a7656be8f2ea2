"""The sizes of a benchmark, and the inputs of every measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from flipperctl.api import Settings
from flipperctl.config import TrainConfig, parse, with_overrides

FAMILIES = (
    "step",
    "stair",
    "building_stair",
    "ramp",
    "uplift",
    "gap",
    "wave",
    "rubble",
    "pallet",
    "plum",
)
"""Terrains of the generalist's training, for measures over all kinds of ground."""

ENGINE_GROUNDS = ("flat", "stair", "plum", "paper_stair")
"""Terrains on which engines are timed: level ground, edges, many edges, the paper's scene."""

SMALL: Mapping[str, Any] = {
    "repeats": 2,
    "episodes": 1,
    "starts": 1,
    "families": 1,
    "updates": 4,
    "batch_sizes": (32,),
    "transitions": 300,
    "seeds": 1,
    "limit": 2.0,
    "validate_every": 100,
    "validation_episodes": 2,
    "calls": 200,
    "decisions": 150,
    "commands": 1,
    "modules": 3,
}
"""Replacements of the defaults with ``--small``, which checks in seconds that everything works."""


class BenchSettings(Settings):
    """The sizes of the measures."""

    repeats: int = Field(
        10, ge=2, le=10_000, description="rounds, with all contestants in each [-]"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of all random numbers [-]")
    controller: str = Field(
        "okada",
        description="physics, engines, accuracy, lookahead: controller plugin that drives [-]",
    )
    episodes: int = Field(
        4,
        ge=1,
        le=1000,
        description="physics, engines: episodes per round; lookahead: episodes per terrain and "
        "controller whose decisions are predicted [-]",
    )
    starts: int = Field(
        20, ge=1, le=10_000, description="accuracy: starts per scene, episodes per terrain [-]"
    )
    families: int = Field(
        len(FAMILIES),
        ge=1,
        le=len(FAMILIES),
        description=f"accuracy, lookahead: terrains, the first of {', '.join(FAMILIES)}; engines: "
        f"the first of {', '.join(ENGINE_GROUNDS)} [-]",
    )
    updates: int = Field(200, ge=1, le=100_000, description="learner: updates per round [-]")
    batch_sizes: tuple[int, ...] = Field(
        (32, 128, 512), min_length=1, description="learner: transitions per update [-]"
    )
    transitions: int = Field(
        20_000, ge=100, le=1_000_000, description="learner: transitions in the replay [-]"
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
    calls: int = Field(5000, ge=10, le=10_000_000, description="latency: calls per round [-]")
    decisions: int = Field(
        2000, ge=100, le=10_000_000, description="latency, scaling: decisions of a short run [-]"
    )
    commands: int = Field(
        100, ge=1, le=100, description="startup: largest number of commands, in help order [-]"
    )
    modules: int = Field(50, ge=1, le=1000, description="discovery: installed plugin modules [-]")


@dataclass(frozen=True)
class Bench:
    """Inputs of a measure."""

    config: TrainConfig
    settings: BenchSettings
    report_progress: Callable[[str, float], None] = lambda what, fraction: None
    """Called with a text on what is measured now and the fraction of the measure that is done."""
    overrides: tuple[str, ...] = ()
    """Overrides that ``config`` was composed of, for processes that compose it again."""


def sizes(*, small: bool, changes: Mapping[str, Any]) -> BenchSettings:
    """Return the defaults, or ``SMALL``, with ``changes`` to them.

    Raises:
        ConfigError: a key or a value is not allowed.
    """
    return with_overrides(parse(BenchSettings, SMALL if small else {}), changes)
