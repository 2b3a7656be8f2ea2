"""The risks that a policy told in an episode, and how well they announced its end.

In: the risk at each decision, between 0 and 1. Out: what was announced, in time or in vain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from flipperctl.core.risk import RiskSign

AHEAD = 3
"""Decisions between a warning and the failing one from which on it is in time [-]."""
_TOLD, _HORIZON, _THRESHOLD = "risks", "risk_horizon", "risk_threshold"


@dataclass(frozen=True)
class EpisodeRisks:
    """The risk at each decision of an episode that has ended."""

    sign: RiskSign
    told: tuple[float, ...]
    """Risk before each of the T decisions, (T,) [-]."""

    def due(self, failed: bool) -> list[bool]:
        """Return at which decisions the episode failed within the horizon, (T,)."""
        first = len(self.told) - self.sign.horizon
        return [failed and t >= first for t in range(len(self.told))]

    @property
    def warnings(self) -> list[bool]:
        """At which decisions the policy warned, (T,)."""
        return list(map(self.sign.warns, self.told))

    @property
    def in_time(self) -> bool:
        """Whether it warned within the horizon before the end and ``AHEAD`` decisions ahead."""
        until = max(0, len(self.told) - AHEAD)
        return any(self.warnings[max(0, len(self.told) - self.sign.horizon) : until])

    @classmethod
    def of(cls, sign: RiskSign, told: Sequence[float]) -> Self:
        """Return the risks with the six digits that rows keep."""
        return cls(sign, tuple(float(f"{risk:.6g}") for risk in told))

    def to_row(self) -> dict[str, Any]:
        """Return the entries of a flat row of an episode."""
        told = " ".join(map(repr, self.told))
        return {_HORIZON: self.sign.horizon, _THRESHOLD: self.sign.threshold, _TOLD: told}

    @classmethod
    def pop(cls, row: dict[str, Any]) -> Self | None:
        """Take the entries out of a flat row; None if it has none.

        Raises:
            ValueError: they are not those of ``to_row``.
        """
        if _TOLD not in row:
            return None
        told = tuple(map(float, row.pop(_TOLD).split()))
        return cls(RiskSign(row.pop(_HORIZON), row.pop(_THRESHOLD)), told)
