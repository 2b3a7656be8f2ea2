"""How well a policy's risk announces failures: in time, in vain, and how far as a probability.

In: episodes with the risk at each decision. Out: counts, their intervals and the calibration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.evaluation.rows import Row, reached
from flipperctl.evaluation.statistics import proportion
from flipperctl.rollout.episode import AHEAD, EpisodeRisks

_EDGES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Edges of the bins in which told and true rates are compared; finer where most risks are."""


def text(found: Mapping[str, Any]) -> str:
    """Return the counts of a summary in one sentence."""
    failures, announced = found["failures"], found["announced"]
    warned = f"warned {AHEAD} or more decisions before {announced:.0f} of {failures:.0f} failures"
    return (
        f"{warned if failures else 'no failure to announce'}; false alarms in "
        f"{found['false_alarms']:.0f} of {found['reached']:.0f} successes (risk of "
        f"{found['threshold']:.2g} or more within {found['horizon']:.0f} decisions)"
    )


Ended = tuple[EpisodeRisks, bool]
"""The risks of an episode, and whether it failed."""


def summary(rows: Iterable[Row]) -> dict[str, Any] | None:
    """Return how the risks in rows fit the ends of the episodes; None without risks."""
    found = [(EpisodeRisks.pop(dict(row)), not reached(row)) for row in rows]
    return summarise([(risks, fails) for risks, fails in found if risks is not None])


def summarise(episodes: Sequence[Ended]) -> dict[str, Any] | None:
    """Return how risks fit the ends of episodes, as plain data; None without episodes.

    All are of one policy, and so have the same sign. ``announced``: failures with a warning within
    the horizon and three or more decisions ahead; ``false_alarms``: episodes that reached the
    finish, with a warning; ``false_warnings``: the share of their decisions with one; ``brier``:
    mean squared difference between the risk and what came, 1 or 0, and that of a constant risk.
    """
    if not episodes:
        return None
    sign = episodes[0][0].sign
    failed = [risks for risks, fails in episodes if fails]
    good = [risks for risks, fails in episodes if not fails]
    announced, alarms = sum(r.in_time for r in failed), sum(any(r.warnings) for r in good)
    warned = [warning for risks in good for warning in risks.warnings]
    told, came = predicted_and_actual(episodes)
    return {
        "horizon": sign.horizon,
        "threshold": sign.threshold,
        "failures": len(failed),
        "announced": announced,
        "announced_rate": proportion(announced, len(failed)).to_dict() if failed else None,
        "reached": len(good),
        "false_alarms": alarms,
        "false_alarm_rate": proportion(alarms, len(good)).to_dict() if good else None,
        "false_warnings": float(np.mean(warned)) if warned else None,
        "brier": brier(told, came),
        "brier_of_mean": brier(np.full(len(came), came.mean()), came),
        "bins": list(_bins(told, came)),
    }


def predicted_and_actual(episodes: Iterable[Ended]) -> tuple[FloatArray, FloatArray]:
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


def _bins(told: FloatArray, came: FloatArray) -> Iterable[dict[str, float]]:
    """Yield predicted and actual rates by risk; bins without decisions are left out."""
    places = np.clip(np.searchsorted(_EDGES, told, side="right") - 1, 0, len(_EDGES) - 2)
    for at, (low, high) in enumerate(pairwise(_EDGES)):
        chosen = places == at
        if chosen.any():
            rates = {"told": float(told[chosen].mean()), "true": float(came[chosen].mean())}
            yield {"low": low, "high": high, "decisions": int(chosen.sum()), **rates}
