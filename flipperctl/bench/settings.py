"""The sizes of the measures of ``flipperctl bench``, and the inputs of every measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field

from flipperctl.api import Settings
from flipperctl.config import TrainConfig, parse, resolver, with_overrides
from flipperctl.errors import ConfigError

SECTION = "bench."
"""Prefix of the keys of the sizes among overrides of the training."""

ENGINE_GROUNDS = ("flat", "stair", "plum", "paper_stair")
"""Terrains on which engines are timed: level ground, edges, many edges, the paper's scene."""


class CommonSettings(Settings):
    """The sizes that measures of several suites share."""

    repeats: int = Field(
        10, ge=2, le=10_000, description="rounds, with all contestants in each [-]"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of all random numbers [-]")
    controller: str = Field("okada", description="controller plugin that drives [-]")
    updates: int = Field(200, ge=1, le=100_000, description="updates of a learner per round [-]")
    batch_sizes: tuple[int, ...] = Field(
        (32, 128, 512), min_length=1, description="transitions per update [-]"
    )
    transitions: int = Field(
        20_000, ge=100, le=1_000_000, description="transitions in a learner's replay [-]"
    )


COMMON_SMALL: Mapping[str, Any] = {
    "repeats": 2,
    "updates": 4,
    "batch_sizes": (32,),
    "transitions": 300,
}
"""Replacements of the defaults with ``--small``, which tests in seconds that everything works."""


class BenchSettings(CommonSettings):
    """The sizes of the measures of ``flipperctl bench``."""

    episodes: int = Field(4, ge=1, le=1000, description="engines: episodes per round [-]")
    families: int = Field(
        len(ENGINE_GROUNDS),
        ge=1,
        le=len(ENGINE_GROUNDS),
        description=f"engines: terrains, the first of {', '.join(ENGINE_GROUNDS)} [-]",
    )
    calls: int = Field(5000, ge=10, le=10_000_000, description="latency: calls per round [-]")
    decisions: int = Field(
        2000,
        ge=100,
        le=10_000_000,
        description="latency: decisions of a short run; scaling: decisions of each worker [-]",
    )
    workers: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = Field(
        (),
        description="scaling: numbers of workers; none: the powers of two up to the number of "
        "cores [-]",
    )


SMALL: Mapping[str, Any] = {
    **COMMON_SMALL,
    "episodes": 1,
    "families": 1,
    "calls": 200,
    "decisions": 150,
}


Sizes = TypeVar("Sizes", bound=CommonSettings)
SizesOfMeasure = TypeVar("SizesOfMeasure", bound=CommonSettings, covariant=True)


@dataclass(frozen=True)
class Bench(Generic[SizesOfMeasure]):
    """Inputs of a measure."""

    config: TrainConfig
    settings: SizesOfMeasure
    report_progress: Callable[[str, float], None] = lambda what, fraction: None
    """Called with a text on the current step and the finished fraction of the measure."""
    overrides: tuple[str, ...] = ()
    """Overrides from which ``config`` was composed, for processes that compose it again."""


@dataclass(frozen=True)
class Suite(Generic[Sizes]):
    """The measures of a command."""

    package: str
    """Package with a module for each measure."""
    measures: tuple[str, ...]
    sizes: type[Sizes]
    small: Mapping[str, Any]
    """Replacements of the defaults of ``sizes`` with ``--small``."""

    def settings(self, *, small: bool, changes: Mapping[str, Any]) -> Sizes:
        """Return the default sizes, or the small ones, with ``changes`` applied.

        Raises:
            ConfigError: a key or a value is not allowed, or there is no such controller.
        """
        try:
            found = with_overrides(parse(self.sizes, self.small if small else {}), changes)
        except ConfigError as error:
            raise ConfigError(f"{SECTION}{error}") from error
        resolver.get("controller", found.controller, f"{SECTION}controller")
        return found
