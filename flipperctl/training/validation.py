"""Validation: evaluates the policy on the same episodes each time and finds the best policy.

Its episodes also calibrate the policy's risk, since no update has learnt from them. The calibration
has two numbers that make probabilities of the outputs, and the threshold of a warning; metrics say
how well both do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from flipperctl.agent.plain import PlainNetworks
from flipperctl.agent.risk import POSITIVES, policy_arrays
from flipperctl.api import FailureRisk, FloatArray, Learning, Outcome
from flipperctl.checkpoint.document import BestBy, Validation
from flipperctl.config import TrainConfig
from flipperctl.config.reward_sum import paying_terms
from flipperctl.core.risk import RiskCalibration, RiskSign
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.metrics import DRAWN
from flipperctl.rollout.collect import Collector, GreedyPlayer
from flipperctl.rollout.episode import Row, validation_seed
from flipperctl.rollout.risks import EpisodeRisks, agreement, predicted_and_actual, threshold_for

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
    rows: Sequence[Row], settings: FailureRisk | None
) -> tuple[RiskCalibration, dict[str, float]] | None:
    """Return the calibration of a validation's risks, which are taken out of its rows.

    Its metrics come with it. Returns None if the rows have no risks.
    """
    # Rows lose their risks here, which belong to no table of a validation.
    results = [(EpisodeRisks.pop(row), row["outcome"] != Outcome.REACHED) for row in rows]
    episodes = [(risks, fails) for risks, fails in results if risks is not None]
    if not episodes or settings is None:
        return None
    # Two numbers make probabilities of the log-odds, fitted on all decisions together.
    predicted, came = predicted_and_actual(episodes)
    slope, shift = fit(_log_odds(predicted), came, settings.horizon)
    sign = RiskSign(settings.horizon, 1.0)
    # The threshold is chosen by probabilities with the digits that rows keep.
    probabilities = []
    for risks, fails in episodes:
        odds = slope * _log_odds(np.array(risks.values)) + shift
        probabilities.append((EpisodeRisks.of(sign, sigmoid(odds).tolist()), fails))
    threshold = threshold_for(probabilities, settings.false_alarms, _LEAST)
    calibration = RiskCalibration(RiskSign(settings.horizon, threshold), slope, shift)
    # The metrics say how well the calibrated risk does with that threshold.
    final = [
        (EpisodeRisks(calibration.sign, risks.values), fails) for risks, fails in probabilities
    ]
    result = agreement(final)
    counts = ("reached", "failures", "announced", "false_alarms")
    metrics = {f"risk_{name}": float(result[name]) for name in counts}
    metrics["risk_false_warnings"] = result["false_warnings"] or 0.0
    metrics["risk_brier"] = result["brier"]
    return calibration, calibration.to_metrics() | metrics


def fit(log_odds: FloatArray, came: FloatArray, horizon: int) -> tuple[float, float]:
    """Return the slope and the shift of the log-odds that fit ``came`` best (Platt 1999).

    ``log_odds`` (D,) come from the bare network; ``came`` (D,) is 1 shortly before a failure, else
    0. The decisions before one failure are no independent evidence: ``horizon`` of them count as
    one. The start is a slope of 1 and the shift that takes the network's weight back. It counts as
    evidence too: a validation without failures, or with failures alone, moves the numbers a little.
    The slope is the exponential of what is fitted, so that it stays positive. The method is
    Newton's, with half steps where a whole one does not improve.
    """
    # Before any episode: a slope of 1, and the shift that takes the network's weight back.
    start = np.array([0.0, -math.log(POSITIVES)])
    weights = np.array([1 / _SLOPES**2, 1 / _SHIFTS**2])

    def loss(at: FloatArray) -> float:
        score = math.exp(at[0]) * log_odds + at[1]
        likelihood = np.logaddexp(0.0, score) - came * score
        return float(likelihood.sum() / horizon + (weights * (at - start) ** 2).sum() / 2)

    # Newton's method on (log slope, shift), from that start.
    fitted = start.copy()
    for _ in range(_STEPS):
        turned = math.exp(fitted[0]) * log_odds
        risk = sigmoid(turned + fitted[1])
        rows = np.stack([turned, np.ones_like(turned)])  # derivatives of the score, (2, D)
        gradient = rows @ (risk - came) / horizon + weights * (fitted - start)
        # The Fisher information, which is positive, in place of the second derivative.
        curvature = (rows * (risk * (1 - risk))) @ rows.T / horizon + np.diag(weights)
        step = np.linalg.solve(curvature, gradient)
        before = loss(fitted)
        while loss(fitted - step) > before and np.abs(step).max() > 1e-9:
            step /= 2
        fitted = fitted - step
        if np.abs(step).max() < 1e-9:
            break
    return math.exp(fitted[0]), float(fitted[1])


def _log_odds(probabilities: FloatArray) -> FloatArray:
    cut = np.clip(probabilities, _CLOSE, 1 - _CLOSE)
    return np.log(cut) - np.log1p(-cut)


def sigmoid(values: FloatArray) -> FloatArray:
    """Return the probabilities of log-odds of any shape."""
    # Computed by logaddexp, which neither overflows nor loses small probabilities.
    return np.exp(-np.logaddexp(0.0, -values))


_BEST_BY: Final[dict[str, BestBy]] = {
    "success": "pitch_variation_100hz",
    "return": "return",
    "last": "decision",
}


class Validator:
    """Validates the learner's policy and keeps the results."""

    def __init__(
        self,
        config: TrainConfig,
        learning: Learning,
        env: FlipperEnv,
        plain: PlainNetworks | None = None,
    ) -> None:
        """``plain``: what the workers drive with; None: the networks of torch."""
        self._learning, self._risk = learning, config.agent.failure_risk
        self._greedy = GreedyPlayer(config, env, plain)
        settings = config.train
        self._seeds = [
            validation_seed(settings.validation_seed, index)
            for index in range(settings.validation_episodes)
        ]
        self.history: list[Validation] = []
        """Results of all validations, oldest first."""
        self._paying = [f"reward_{name}" for name in paying_terms(config.rewards)]
        self.best_by = _BEST_BY[settings.best_by]
        """What ranks the validations."""

    @property
    def best(self) -> Validation | None:
        """Best validation so far by ``best_by``."""
        return max(self.history, key=lambda v: v.score(self.best_by), default=None)

    @property
    def last(self) -> Validation | None:
        """Newest validation."""
        return self.history[-1] if self.history else None

    def validate(self, collector: Collector, decision: int) -> Validation | None:
        """Play all episodes, which the collector distributes; return and keep the result.

        ``decision``: number of decisions of the run so far. Returns None if the run is to stop
        before the last episode has ended.
        """
        weights = policy_arrays(self._learning.policy, self._learning.risk)
        self._greedy.load(weights)
        rows = collector.evaluate(weights, self._seeds, self._greedy.play)
        if rows is None:
            return None
        reached_rows = [row for row in rows if row["outcome"] == Outcome.REACHED]
        risk = calibrated(rows, self._risk)
        numbers = [n for n, v in rows[0].items() if isinstance(v, float | int) and n != "seed"]
        names = [n for n in numbers if not n.startswith(DRAWN)]  # parts of a mix draw others
        # Means over the episodes that reached the finish, as in the paper; over all if none did.
        averaged = reached_rows or rows
        means = {name: float(np.mean([row[name] for row in averaged])) for name in names}
        success = len(reached_rows) / len(rows)
        # Shaping ranks no policy: the returns sum the paying terms alone.
        returns = [sum(float(row[name]) for name in self._paying) for row in rows]
        self.history.append(
            Validation(
                decision=decision,
                success_rate=success,
                mean_return=float(np.mean(returns)),
                **means,
                **({} if risk is None else risk[1]),
            )
        )
        return self.history[-1]
