"""Settings, search space and objective of a search with Optuna."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from flipperctl.api import Settings
from flipperctl.cli.overrides import parse_overrides
from flipperctl.errors import ConfigError

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


class SearchSettings(Settings):
    """The section ``hydra.sweeper`` of a search."""

    n_trials: int = Field(
        20,
        ge=1,
        le=100_000,
        description="finished trials of the whole study, including earlier starts",
    )
    n_jobs: int = Field(
        1, ge=1, le=1000, description="trials proposed at once, for a launcher to run side by side"
    )
    storage: str | None = Field(
        None,
        description="URL of the study's database, as in sqlite:///search.db; null: in memory",
    )
    study_name: str = Field("search", min_length=1, description="name of the study in the storage")
    sampler: Literal["tpe", "random"] = Field("tpe", description="Optuna's sampler")
    seed: int = Field(1, ge=0, lt=2**31, description="seed of the proposals")


def objective(best: dict[str, Any] | None, episodes: int) -> float | None:
    """Return the objective that a sweeper maximises, from a run's best validation.

    It is the success rate minus a penalty of at most one episode that grows with θ̂_R at 100 Hz
    [rad]: ``success − θ̂_R / (1 + θ̂_R) / episodes``. It orders runs like validations: by success,
    then by θ̂_R. None if there was no validation. In a run of an earlier version that did not
    record θ̂_R at 100 Hz, it is θ̂_R at decisions.
    """
    if best is None:
        return None
    swing = best.get("pitch_variation_100hz")
    if swing is None:  # a run of an earlier version
        swing = best["pitch_variation"] or 0.0
    penalty = swing / (1.0 + swing) if math.isfinite(swing) else 1.0
    return float(best["success_rate"]) - penalty / episodes


def search_space(arguments: Sequence[str]) -> tuple[dict[str, BaseDistribution], list[str]]:
    """Return the distributions that Optuna samples, by key, and the fixed overrides.

    Raises:
        ConfigError: there is nothing to sample, or a logarithmic interval reaches zero.
    """
    from optuna.distributions import (
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )

    space: dict[str, BaseDistribution] = {}
    fixed = []
    for override in parse_overrides(arguments):
        key = override.get_key_element()
        if override.is_interval_sweep():
            sweep: Any = override.value()
            whole = isinstance(sweep.start, int) and isinstance(sweep.end, int)
            try:
                space[key] = (IntDistribution if whole else FloatDistribution)(
                    sweep.start, sweep.end, log="log" in sweep.tags
                )
            except ValueError as error:
                raise ConfigError(f"{override.input_line}: {error}") from error
        elif override.is_sweep_override():
            space[key] = CategoricalDistribution(list(override.sweep_string_iterator()))
        else:
            fixed.append(str(override.input_line))
    if not space:
        raise ConfigError(
            "hydra/sweeper=optuna has nothing to search; give an interval or a list, as in "
            "'agent.learning_rate=tag(log,interval(1e-4,3e-3))' or agent.batch_size=64,128"
        )
    return space, fixed
