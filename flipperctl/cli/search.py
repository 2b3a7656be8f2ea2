"""What a search over settings is made of: its own settings, what it draws, what it maximises."""

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
    """``hydra.sweeper`` of a search."""

    n_trials: int = Field(
        20, ge=1, le=100_000, description="trials of the whole study, those of earlier starts too"
    )
    n_jobs: int = Field(
        1, ge=1, le=1000, description="trials proposed at once, for a launcher to run side by side"
    )
    storage: str | None = Field(
        None, description="where the study is kept, as in sqlite:///search.db; null: nowhere"
    )
    study_name: str = Field("search", min_length=1, description="name of the study in the storage")
    sampler: Literal["tpe", "random"] = Field("tpe", description="how Optuna proposes")
    seed: int = Field(1, ge=0, lt=2**31, description="seed of the proposals")


def objective(best: dict[str, Any] | None, episodes: int) -> float | None:
    """What a sweeper makes as large as it can, from a run's best validation.

    The success rate, less a penalty of one episode's worth that grows with θ̂_R [rad]:
    ``success − θ̂_R / (1 + θ̂_R) / episodes``. It orders runs as validations are ordered: by
    success, then by θ̂_R.
    """
    if best is None:
        return None
    swing = float(best["pitch_variation"] or 0.0)
    penalty = swing / (1.0 + swing) if math.isfinite(swing) else 1.0
    return float(best["success_rate"]) - penalty / episodes


def search_space(arguments: Sequence[str]) -> tuple[dict[str, BaseDistribution], list[str]]:
    """What Optuna draws, by key, and the overrides that stay as they are.

    Raises:
        ConfigError: nothing is left to draw, or a logarithmic interval reaches zero.
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
            "hydra/sweeper=optuna has nothing to draw; give an interval or a list, as in "
            "'agent.learning_rate=tag(log,interval(1e-4,3e-3))' or agent.batch_size=64,128"
        )
    return space, fixed
