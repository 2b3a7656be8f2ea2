"""Compares the risks that a policy tells with the ends of its episodes.

In: the risk at each decision of episodes, and whether they failed. Out: how many failures are
announced in time and in vain, how far risks are probabilities, and the threshold of a warning.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.core.risk import RiskSign

AHEAD = 3
"""Decisions from a warning to the failure, at least, for the warning to be in time [-]."""
_RISKS, _HORIZON, _THRESHOLD = "risks", "risk_horizon", "risk_threshold"


@dataclass(frozen=True)
class EpisodeRisks:
    """The risk at each decision of an episode that has ended."""

    sign: RiskSign
    values: tuple[float, ...]
    """Risk before each of the T decisions, (T,) [-]."""

    def due(self, failed: bool) -> list[bool]:
        """Return at which decisions the episode failed within the horizon, (T,)."""
        first = len(self.values) - self.sign.horizon
        return [failed and t >= first for t in range(len(self.values))]

    @property
    def warnings(self) -> list[bool]:
        """At which decisions the policy warned, (T,)."""
        return list(map(self.sign.warns, self.values))

    @property
    def in_time(self) -> bool:
        """Whether it warned within the horizon before the end and ``AHEAD`` decisions ahead."""
        count = len(self.values)
        return any(self.warnings[max(0, count - self.sign.horizon) : max(0, count - AHEAD)])

    @classmethod
    def of(cls, sign: RiskSign, risks: Sequence[float]) -> Self:
        """Return the risks with the six digits that rows keep."""
        return cls(sign, tuple(float(f"{risk:.6g}") for risk in risks))

    def to_row(self) -> dict[str, Any]:
        """Return the entries of a flat row of an episode."""
        risks = " ".join(map(repr, self.values))
        return {_HORIZON: self.sign.horizon, _THRESHOLD: self.sign.threshold, _RISKS: risks}

    @classmethod
    def pop(cls, row: dict[str, Any]) -> Self | None:
        """Take the entries out of a flat row; None if it has none."""
        if _RISKS not in row:
            return None
        risks = tuple(map(float, row.pop(_RISKS).split()))
        return cls(RiskSign(row.pop(_HORIZON), row.pop(_THRESHOLD)), risks)


_EDGES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Edges of the bins in which told and true rates are compared; finer where most risks are."""
Ended = tuple[EpisodeRisks, bool]
"""The risks of an episode, and whether it failed."""


def agreement(episodes: Sequence[Ended]) -> dict[str, Any]:
    """Return how risks fit the ends of one or more episodes, as plain data.

    All are of one policy, and so have the same sign. ``announced``: failures with a warning within
    the horizon and three or more decisions ahead. ``false_alarms``: episodes that reached the
    finish, with a warning; ``false_warnings``: the share of their decisions with a warning, None
    if none reached it. ``brier``: mean squared difference between the risk and what came, 1 or 0;
    ``brier_of_mean``: the same of a constant risk.
    """
    # Failures should be announced, and successes should be left alone.
    failed = [risks for risks, fails in episodes if fails]
    good = [risks for risks, fails in episodes if not fails]
    warned = [warning for risks in good for warning in risks.warnings]
    predicted, actual = predicted_and_actual(episodes)
    return {
        "horizon": episodes[0][0].sign.horizon,
        "threshold": episodes[0][0].sign.threshold,
        "failures": len(failed),
        "announced": sum(risks.in_time for risks in failed),
        "reached": len(good),
        "false_alarms": sum(any(risks.warnings) for risks in good),
        "false_warnings": float(np.mean(warned)) if warned else None,
        "brier": brier(predicted, actual),
        "brier_of_mean": brier(np.full(len(actual), actual.mean()), actual),
        "bins": list(_bins(predicted, actual)),
    }


def predicted_and_actual(episodes: Iterable[Ended]) -> tuple[FloatArray, FloatArray]:
    """Return the risk of each decision, and 1 if the failure came in time, else 0, (D,) each."""
    pairs = [
        pair
        for risks, fails in episodes
        for pair in zip(risks.values, risks.due(fails), strict=True)
    ]
    predicted, actual = np.array(pairs, np.float64).reshape(-1, 2).T
    return predicted, actual


def threshold_for(episodes: Sequence[Ended], false_alarms: float, least: float) -> float:
    """Return the smallest threshold, ``least`` or more, with no more than so many false alarms.

    ``false_alarms``: largest share of the reached episodes with a warning [-].
    """
    highest = sorted((max(risks.values) for risks, fails in episodes if not fails), reverse=True)
    allowed = int(false_alarms * len(highest) + 1e-9)
    if allowed >= len(highest):
        return least
    # Above the first episode that must not warn; a risk of 1 cannot be exceeded.
    return min(1.0, max(least, float(np.nextafter(highest[allowed], 2.0))))


def brier(predicted: FloatArray, actual: FloatArray) -> float:
    """Return the mean squared difference (Brier 1950) of (D,) probabilities and outcomes [-]."""
    return float(np.square(predicted - actual).mean())


def _bins(predicted: FloatArray, actual: FloatArray) -> Iterable[dict[str, float]]:
    """Yield predicted and actual rates by risk; bins without decisions are left out."""
    places = np.clip(np.searchsorted(_EDGES, predicted, side="right") - 1, 0, len(_EDGES) - 2)
    for at, (low, high) in enumerate(pairwise(_EDGES)):
        inside = places == at
        if inside.any():
            rates = {"told": float(predicted[inside].mean()), "true": float(actual[inside].mean())}
            yield {"low": low, "high": high, "decisions": int(inside.sum()), **rates}
