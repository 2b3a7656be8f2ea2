"""What a search samples and maximises: settings, space and objective.

In: the settings and overrides of the search. Out: the parameters, intervals and lists of choices,
as Optuna's distributions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, ValidationError

from flipperctl.api import Settings
from flipperctl.errors import ConfigError, MissingExtraError
from flipperctl.messages import explain

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


class SearchSettings(Settings):
    """The section ``hydra.sweeper`` of a search."""

    n_trials: int = Field(
        20,
        ge=1,
        le=100_000,
        description="finished trials of the whole study, those of earlier starts included",
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


def objective(best: dict[str, Any] | None, episodes: int, best_by: str = "success") -> float | None:
    """Return the objective that a sweeper maximises, from a run's best validation.

    It is the mean return if ``best_by``, as in ``train.best_by``, is ``return``. Else it is the
    success rate minus a penalty of at most one episode that grows with θ̂_R at 100 Hz [rad]:
    ``success − θ̂_R / (1 + θ̂_R) / episodes``. It orders runs as validations are ordered: by success,
    then by θ̂_R. Return None if there was no validation.
    """
    if best is None:
        return None
    if best_by == "return":
        return float(best["mean_return"])
    variation = best["pitch_variation_100hz"]
    penalty = variation / (1.0 + variation) if math.isfinite(variation) else 1.0
    return float(best["success_rate"]) - penalty / episodes


def check_settings(given: Mapping[str, Any]) -> SearchSettings:
    """Return the settings of a search."""
    try:
        import optuna
    except ImportError as error:
        raise MissingExtraError(
            "hydra/sweeper=optuna needs the package optuna; install flipperctl[optuna]"
        ) from error
    try:
        settings = SearchSettings(**given)
    except ValidationError as error:
        raise ConfigError(explain(error, "hydra.sweeper", SearchSettings)) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return settings


@dataclass(frozen=True)
class Interval:
    """An interval of numbers, of integers if both ends are integers."""

    low: float
    high: float
    log: bool
    """Whether numbers are sampled on a logarithmic scale."""
    typed: str
    """The override, for errors."""

    @property
    def whole(self) -> bool:
        """Whether the numbers are integers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def probes(self) -> tuple[float, float, float]:
        """Return both ends and a number between them, a fraction unless both are integers."""
        between = self.low + 0.3819 * (self.high - self.low)
        return self.low, self.high, self.low if self.whole else between


def distributions(
    sampled: Mapping[str, Interval | Sequence[str]],
) -> dict[str, BaseDistribution]:
    """Return the distribution of each key."""
    from optuna.distributions import CategoricalDistribution

    if not sampled:
        raise ConfigError(
            "hydra/sweeper=optuna has nothing to search; give an interval or a list, as in "
            "'agent.learning_rate=tag(log,interval(1e-4,3e-3))' or agent.batch_size=64,128"
        )
    return {
        key: _numbers(one) if isinstance(one, Interval) else CategoricalDistribution(list(one))
        for key, one in sampled.items()
    }


def _numbers(interval: Interval) -> BaseDistribution:
    from optuna.distributions import FloatDistribution, IntDistribution

    made = IntDistribution if interval.whole else FloatDistribution
    try:
        low, high = interval.low, interval.high
        return made(low, high, log=interval.log)  # type: ignore[arg-type]  # both are of its kind
    except ValueError as error:
        raise ConfigError(f"{interval.typed}: {error}") from error
