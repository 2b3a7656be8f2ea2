"""Means, rates and differences, each with its 95 % interval."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Interval:
    """A mean or a rate and its 95 % interval, in the unit of the values."""

    mean: float
    low: float | None
    """Lower end; None, like ``high``, if there are too few values for an interval."""
    high: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name."""
        return asdict(self)


@dataclass(frozen=True)
class Estimate(Interval):
    """The mean of a measure over episodes: times [s], angles [rad], returns [-]."""

    range: float
    """Largest value minus the smallest."""


@dataclass(frozen=True)
class PairedDifference(Interval):
    """The mean difference over equal seeds, a policy's value minus its baseline's."""

    episodes: int
    """Number of seeds with which both reached the finish."""


@dataclass(frozen=True)
class PairedSuccess(Interval):
    """The difference of two success rates over equal seeds, a policy's minus its baseline's."""

    episodes: int
    """Number of seeds."""
    won: int
    """Number of seeds with which only the policy reached the finish."""
    lost: int
    """Number of seeds with which only the baseline reached the finish."""
    p: float
    """Two-sided p-value of McNemar's exact test [-]."""
    p_holm: float
    """The same, corrected for all such comparisons that are shown together (Holm) [-]."""
