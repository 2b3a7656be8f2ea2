"""How much a benchmark measures, and what every measure is handed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from flipperctl.api import Settings
from flipperctl.config import TrainConfig, parse, with_overrides

SMALL: Mapping[str, Any] = {
    "repeats": 2,
    "episodes": 1,
    "starts": 1,
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
"""In place of the defaults under ``--small``: shows in seconds that everything works."""


class BenchSettings(Settings):
    """The sizes of the measures."""

    repeats: int = Field(10, ge=2, le=10_000, description="rounds, contestants in turn [-]")
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of what is drawn [-]")
    controller: str = Field("okada", description="plugin whose actions physics repeats [-]")
    episodes: int = Field(4, ge=1, le=1000, description="physics: episodes a round [-]")
    starts: int = Field(20, ge=1, le=10_000, description="accuracy: starts a scene [-]")
    updates: int = Field(200, ge=1, le=100_000, description="learner: updates a round [-]")
    batch_sizes: tuple[int, ...] = Field(
        (32, 128, 512), min_length=1, description="learner: transitions an update [-]"
    )
    transitions: int = Field(
        20_000, ge=100, le=1_000_000, description="learner: transitions in the replay [-]"
    )
    seeds: int = Field(5, ge=1, le=100, description="solve: seeds a contestant [-]")
    limit: float = Field(600.0, gt=0, le=86_400, description="solve: longest time a run [s]")
    validate_every: int = Field(
        1000, ge=1, le=1_000_000, description="solve: decisions between validations [-]"
    )
    validation_episodes: int = Field(
        100, ge=1, le=10_000, description="solve: episodes a validation, all to succeed [-]"
    )
    in_a_row: int = Field(3, ge=1, le=100, description="solve: such validations in a row [-]")
    calls: int = Field(5000, ge=10, le=10_000_000, description="latency: calls a round [-]")
    decisions: int = Field(
        2000, ge=100, le=10_000_000, description="latency, scaling: decisions of a short run [-]"
    )
    commands: int = Field(
        100, ge=1, le=100, description="startup: commands measured at most, in the help's order [-]"
    )
    modules: int = Field(50, ge=1, le=1000, description="discovery: installed plugin modules [-]")


@dataclass(frozen=True)
class Bench:
    """What every measure is handed."""

    config: TrainConfig
    settings: BenchSettings
    tell: Callable[[str, float], None] = lambda what, share: None
    """Told what is measured now, and which share of the measure is done."""
    overrides: tuple[str, ...] = ()
    """Those of which ``config`` was made, for processes that compose it anew."""


def sizes(*, small: bool, changes: Mapping[str, Any]) -> BenchSettings:
    """The defaults, or ``SMALL``, with ``changes`` laid over them.

    Raises:
        ConfigError: a key or a value that is not allowed.
    """
    return with_overrides(parse(BenchSettings, SMALL if small else {}), changes)
