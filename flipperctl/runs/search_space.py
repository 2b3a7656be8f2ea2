"""The parameters of a search, intervals and lists of choices, as Optuna's distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from flipperctl.errors import ConfigError

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


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
    """Return the distribution of each key.

    Raises:
        ConfigError: there is nothing to sample, or a logarithmic interval reaches zero.
    """
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
