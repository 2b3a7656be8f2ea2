"""How well a policy's risk announces failures: in time, in vain, and how far as a probability.

In: episodes with the risk at each decision. Out: counts, their intervals and the calibration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.intervals import proportion
from flipperctl.rollout.risks import AHEAD, EpisodeRisks

_EDGES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Edges of the bins in which told and true rates are compared; finer where most risks are."""


@dataclass(frozen=True)
class RiskBin:
    """The decisions whose risk lies between two edges."""

    low: float
    high: float
    decisions: int
    told: float
    """Mean risk [-]."""
    true: float
    """Share of the decisions after which the episode failed within the horizon [-]."""


@dataclass(frozen=True)
class RiskSummary:
    """How a policy's risk and its warnings fit the ends of its episodes."""

    horizon: int
    """Decisions within which the failure is expected [-]."""
    threshold: float
    """Smallest risk that is a warning [-]."""
    failures: int
    """Number of episodes that failed."""
    announced: int
    """Failures with a warning within the horizon and three or more decisions ahead."""
    announced_rate: Interval | None
    """Their share, with its 95 % interval; None without a failure."""
    reached: int
    """Number of episodes that reached the finish."""
    false_alarms: int
    """Episodes that reached the finish, with a warning."""
    false_alarm_rate: Interval | None
    """Their share, with its 95 % interval; None if no episode reached the finish."""
    false_warnings: float | None
    """Share of the decisions of reached episodes with a warning [-]."""
    brier: float
    """Mean squared difference between the risk and what came, 1 or 0 [-]."""
    brier_of_mean: float
    """The same of a constant risk, the share of the decisions that came before a failure [-]."""
    bins: tuple[RiskBin, ...]
    """Told and true rates, by risk; bins without decisions are left out."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def risk_text(found: Mapping[str, Any]) -> str:
    """Return the counts of a summary, as plain data, in one sentence."""
    failures, announced = found["failures"], found["announced"]
    share = found["false_warnings"]
    failed = (
        f"{announced:.0f} of {failures:.0f} failures were announced {AHEAD} or more decisions ahead"
        if failures
        else "no failure to announce"
    )
    told = "" if share is None else f", at {share:.1%} of their decisions"
    return (
        f"{failed}; warnings in {found['false_alarms']:.0f} of {found['reached']:.0f} episodes "
        f"that reached the finish{told} (risk of {found['threshold']:.2g} or more within "
        f"{found['horizon']:.0f} decisions)"
    )


Ended = tuple[EpisodeRisks, bool]
"""The risks of an episode, and whether it failed."""


def summarise_risk(episodes: Sequence[Ended]) -> RiskSummary | None:
    """Return how risks fit the ends of episodes; None without episodes.

    All are of one policy, and so have the same sign.
    """
    if not episodes:
        return None
    sign = episodes[0][0].sign
    failed = [risks for risks, fails in episodes if fails]
    reached = [risks for risks, fails in episodes if not fails]
    announced, alarms = sum(r.in_time for r in failed), sum(any(r.warnings) for r in reached)
    warned = [warning for risks in reached for warning in risks.warnings]
    told, came = told_and_came(episodes)
    return RiskSummary(
        sign.horizon,
        sign.threshold,
        failures=len(failed),
        announced=announced,
        announced_rate=proportion(announced, len(failed)) if failed else None,
        reached=len(reached),
        false_alarms=alarms,
        false_alarm_rate=proportion(alarms, len(reached)) if reached else None,
        false_warnings=float(np.mean(warned)) if warned else None,
        brier=brier(told, came),
        brier_of_mean=brier(np.full(len(came), came.mean()), came),
        bins=tuple(_bins(told, came)),
    )


def told_and_came(episodes: Iterable[Ended]) -> tuple[FloatArray, FloatArray]:
    """Return the risk of each decision, and 1 if the failure came in time, else 0, (D,) each."""
    pairs = [
        pair for risks, fails in episodes for pair in zip(risks.told, risks.due(fails), strict=True)
    ]
    told, came = np.array(pairs, np.float64).reshape(-1, 2).T
    return told, came


def threshold_for(episodes: Sequence[Ended], false_alarms: float, least: float) -> float:
    """Return the smallest threshold, ``least`` or more, with no more than so many false alarms.

    ``false_alarms``: largest share of the reached episodes with a warning [-].
    """
    highest = sorted((max(risks.told) for risks, fails in episodes if not fails), reverse=True)
    allowed = int(false_alarms * len(highest) + 1e-9)
    if allowed >= len(highest):
        return least
    # Above the first episode that must not warn; a risk of 1 cannot be exceeded.
    return min(1.0, max(least, float(np.nextafter(highest[allowed], 2.0))))


def brier(told: FloatArray, came: FloatArray) -> float:
    """Return the mean squared difference (Brier 1950) of (D,) probabilities and outcomes [-]."""
    return float(np.square(told - came).mean())


def _bins(told: FloatArray, came: FloatArray) -> Iterable[RiskBin]:
    places = np.clip(np.searchsorted(_EDGES, told, side="right") - 1, 0, len(_EDGES) - 2)
    for at, (low, high) in enumerate(pairwise(_EDGES)):
        chosen = places == at
        if chosen.any():
            rates = float(told[chosen].mean()), float(came[chosen].mean())
            yield RiskBin(low, high, int(chosen.sum()), *rates)
