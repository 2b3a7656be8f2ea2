"""The calibration of a risk on the episodes of a validation, which no update has learnt from.

In: the rows of validation episodes with the risks of the bare network. Out: two numbers that make
probabilities of its outputs, the threshold of a warning, and how well both do on these episodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from flipperctl.agent.risk import POSITIVES
from flipperctl.api import FloatArray, Outcome
from flipperctl.config import Agent
from flipperctl.core.risk import RiskCalibration, RiskSign
from flipperctl.evaluation.views.risk import Ended, predicted_and_actual, summarise, threshold_for
from flipperctl.rollout.episode import Row
from flipperctl.rollout.risks import EpisodeRisks

_LEAST: Final = 0.05
"""Smallest threshold of a warning [-], however few false alarms a smaller one would give."""
_CLOSE: Final = 1e-6
"""Distance from 0 and 1 at which a probability is cut, before its log-odds are taken [-]."""
_SLOPES: Final = 0.5
"""Standard deviation of the slope's logarithm before any episode [-]."""
_SHIFTS: Final = 2.0
"""Standard deviation of the shift before any episode [-]."""
_STEPS: Final = 50


def calibrated(
    rows: Sequence[Row], settings: Agent
) -> tuple[RiskCalibration, dict[str, float]] | None:
    """Return the calibration of a validation's risks, which are taken out of its rows.

    Its metrics come with it. Returns None if the rows have no risks.
    """
    found = [(EpisodeRisks.pop(row), row["outcome"] != Outcome.REACHED) for row in rows]
    episodes = [(risks, fails) for risks, fails in found if risks is not None]
    if not episodes:
        return None
    told, came = predicted_and_actual(episodes)
    slope, shift = fit(_log_odds(told), came, settings.risk_horizon)
    sign = RiskSign(settings.risk_horizon, 1.0)
    probabilities = [
        (EpisodeRisks.of(sign, _probabilities(risks, slope, shift)), fails)
        for risks, fails in episodes
    ]
    threshold = threshold_for(probabilities, settings.risk_false_alarms, _LEAST)
    calibration = RiskCalibration(RiskSign(settings.risk_horizon, threshold), slope, shift)
    final = [(EpisodeRisks(calibration.sign, risks.told), fails) for risks, fails in probabilities]
    return calibration, calibration.to_metrics() | _metrics(final)


def fit(log_odds: FloatArray, came: FloatArray, horizon: int) -> tuple[float, float]:
    """Return the slope and the shift of the log-odds that fit ``came`` best (Platt 1999).

    ``log_odds`` (D,) are those of the bare network, ``came`` (D,) is 1 shortly before a failure,
    else 0. The decisions before one failure are no independent evidence: ``horizon`` of them
    count as one. The start, a slope of 1 and the shift that takes the network's weight back,
    counts as evidence too, so that a validation without failures or with failures alone moves the
    numbers a little. The slope is the exponential of what is fitted, so that it stays positive.
    Newton's method, with half steps where a whole one does not improve.
    """
    start = np.array([0.0, -math.log(POSITIVES)])
    weights = np.array([1 / _SLOPES**2, 1 / _SHIFTS**2])

    def loss(at: FloatArray) -> float:
        score = math.exp(at[0]) * log_odds + at[1]
        likelihood = np.logaddexp(0.0, score) - came * score
        return float(likelihood.sum() / horizon + (weights * (at - start) ** 2).sum() / 2)

    found = start.copy()
    for _ in range(_STEPS):
        turned = math.exp(found[0]) * log_odds
        risk = _sigmoid(turned + found[1])
        rows = np.stack([turned, np.ones_like(turned)])  # derivatives of the score, (2, D)
        gradient = rows @ (risk - came) / horizon + weights * (found - start)
        # The Fisher information, which is positive, in place of the second derivative.
        curvature = (rows * (risk * (1 - risk))) @ rows.T / horizon + np.diag(weights)
        step = np.linalg.solve(curvature, gradient)
        before = loss(found)
        while loss(found - step) > before and np.abs(step).max() > 1e-9:
            step /= 2
        found = found - step
        if np.abs(step).max() < 1e-9:
            break
    return math.exp(found[0]), float(found[1])


def _probabilities(risks: EpisodeRisks, slope: float, shift: float) -> list[float]:
    found: list[float] = _sigmoid(slope * _log_odds(np.array(risks.told)) + shift).tolist()
    return found


def _metrics(episodes: Sequence[Ended]) -> dict[str, float]:
    """Return the numbers of a summary that a validation keeps."""
    found = summarise(episodes)
    assert found is not None  # there are episodes
    counts = ("reached", "failures", "announced", "false_alarms")
    return {
        **{f"risk_{name}": float(found[name]) for name in counts},
        "risk_false_warnings": found["false_warnings"] or 0.0,
        "risk_brier": found["brier"],
    }


def _log_odds(probabilities: FloatArray) -> FloatArray:
    cut = np.clip(probabilities, _CLOSE, 1 - _CLOSE)
    return np.log(cut) - np.log1p(-cut)


def _sigmoid(values: FloatArray) -> FloatArray:
    return np.exp(-np.logaddexp(0.0, -values))
