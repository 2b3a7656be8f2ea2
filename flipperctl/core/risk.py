"""The sign that an episode is about to fail, and how a policy that warns gets away.

In: the observations of an episode, where the robot was by its odometry, and what a policy's network
says about the newest observation. Out: the risk, whether it is a warning, and the action. Simulator
and robot share this definition.

A single observation does not show whether the robot still moves. Observations of a stuck robot
repeat, so that the newest one resembles earlier ones. On a level floor they also repeat while the
robot drives; there, odometry shows the motion. A deterministic policy that is stuck repeats its
actions. Drawn actions end the repetition, and are likely to be good ones, since the probabilities
follow the Q-values. The sign presumes that the belts drive, as they do in training.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import sub

import numpy as np
from numpy.typing import NDArray

LAGS = (1, 2, 4, 8, 16)
"""Numbers of decisions after which observations are compared [-]."""
SCALE = 0.03
"""Mean difference of the numbers of two observations that resemble each other by 1/e [m, rad]."""
STANDING_DECISIONS, STANDING_SHARE = 10, 0.2
"""A robot stands if it has moved less than this share of the way that its belts command, over so
many decisions [-]."""
MEANING = (
    "probability = 1 / (1 + exp(-(log-odds of risk + sum of risk_recurrence * resemblance))) that "
    "the episode ends overturned, stuck or out of time within the next horizon decisions, the one "
    "that follows included; resemblance = exp(-mean |observation - observation lag decisions "
    "earlier| / scale) for each lag, 0 where the episode is shorter; a warning is a probability of "
    "threshold or more; a robot that stands by its odometry, having moved in "
    f"{STANDING_DECISIONS} decisions less than {STANDING_SHARE:g} of the way that its belts "
    "command, has a probability of (1 + threshold) / 2 or more"
)
"""The sign in words, for the metadata of exported policies."""
Place = Sequence[float]
"""Coordinates of the chassis centre by odometry, from an origin of its own, 2 or 3 of them [m]."""
_LEAST, _MOST = 1e-12, 1 - 1e-5
"""Ends at which a probability is cut, before its log-odds are taken [-]; closer to 1, single
precision has too few digits for them."""
_FAR = 50.0
"""Largest log-odds, both ways [-]; beyond it a probability in double precision is 0 or 1."""


def resemblances(observations: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how much each observation of an episode resembles earlier ones, (T, lags) [-].

    ``observations``: (T, n) in SI units, oldest first. A resemblance is 1 for equal ones, and 0
    for an observation from before the episode.
    """
    columns = np.zeros((len(observations), len(LAGS)), np.float32)
    for column, lag in enumerate(LAGS):
        difference = np.abs(observations[lag:] - observations[:-lag]).mean(axis=1)
        columns[lag:, column] = np.exp(-difference / SCALE)
    return columns


def with_recurrence(
    risk: float, coefficients: NDArray[np.float32], resembles: NDArray[np.float32]
) -> float:
    """Return the risk of an observation with its episode's past; NaN if a number is not finite.

    ``risk``: risk of the observation alone, 0 to 1; ``coefficients``: what each resemblance adds to
    its log-odds, (lags,); ``resembles``: the resemblances, (lags,).
    """
    added = float(coefficients.dot(resembles))
    if not math.isfinite(risk + added):
        return math.nan
    # Log-odds add up; the cuts keep them finite.
    cut = min(_MOST, max(_LEAST, risk))
    score = math.log(cut / (1 - cut)) + added
    return 1 / (1 + math.exp(-min(_FAR, max(-_FAR, score))))


@dataclass(frozen=True)
class RiskSign:
    """When a policy warns."""

    horizon: int
    """Decisions within which the failure is expected [-]."""
    threshold: float
    """Smallest risk that is a warning, above 0 and at most 1 [-]."""

    def warns(self, risk: float | None) -> bool:
        """Return whether a risk is a warning; None, an unknown risk, is none."""
        return risk is not None and risk >= self.threshold


class EpisodeRisk:
    """The risk of an episode's newest observation, while the episode lasts."""

    def __init__(self, size: int, sign: RiskSign, stride: float = 0.0) -> None:
        """``size``: length n of an observation; ``sign``: when the risk is a warning.

        ``stride``: way that the belts command in a decision [m]; 0: no robot is taken to stand.
        """
        length, lags = LAGS[-1] + 1, np.array(LAGS)
        self._kept = np.zeros((length, size), np.float32)  # a ring
        # Tables, one product and results in place, since this runs at each decision on the robot.
        self._rows = [*((np.arange(length)[:, None] - lags) % length)]  # length arrays, (lags,)
        self._known = [*(lags <= np.arange(length)[:, None]).astype(np.float32)]
        self._mean = np.full(size, -1 / (SCALE * size), np.float32)
        self._count, self._size = 0, size
        self._standing_risk = (1 + sign.threshold) / 2
        self._way = STANDING_SHARE * STANDING_DECISIONS * stride  # [m]
        self._places: deque[Place] = deque(maxlen=STANDING_DECISIONS + 1)

    def reset(self) -> None:
        """Begin an episode."""
        self._count = 0
        self._places.clear()

    def update(
        self,
        risk: float,
        coefficients: NDArray[np.float32],
        observations: NDArray[np.float32],
        place: Place | None = None,
    ) -> float:
        """Add a decision; return its risk, NaN if a number is not finite; call it once a decision.

        ``risk`` and ``coefficients``: see ``with_recurrence``; ``observations``: the network's
        input, whose last n numbers are the newest observation; ``place``: where the robot is;
        None: it has no odometry. The risk of a robot that stands is half way from a warning to
        certainty, or more. This fits the policy ``generalist``: after 0.4 to 0.9 of such
        decisions, more on harder ground, its episode failed within the horizon.
        """
        newest = observations[-self._size :]
        moving = with_recurrence(risk, coefficients, self.resemblances(newest))
        return max(moving, self._standing_risk) if self._stands(place) else moving  # NaN stays

    def _stands(self, place: Place | None) -> bool:
        places = self._places
        if place is None:
            places.clear()
            return False
        places.append(place)
        moved = math.hypot(*map(sub, place, places[0]))
        return len(places) == places.maxlen and moved < self._way

    def resemblances(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Add the newest observation, (n,); return its resemblances, (lags,)."""
        count, length = self._count, len(self._kept)
        at = count % length
        self._kept[at] = observation
        difference = self._kept.take(self._rows[at], axis=0)  # (lags, n)
        difference -= observation
        np.abs(difference, out=difference)
        nearness: NDArray[np.float32] = difference.dot(self._mean)
        np.exp(nearness, out=nearness)
        # Before the episode there was nothing to resemble.
        if count < length - 1:
            nearness *= self._known[count]
        self._count = count + 1
        return nearness


@dataclass(frozen=True)
class RiskCalibration:
    """Two numbers that make a probability of a network's output (Platt 1999), and the sign."""

    sign: RiskSign
    slope: float
    """Factor of the network's output, above 0, so that the order of risks stays [-]."""
    shift: float
    """Added to the product, in log-odds [-]."""

    def to_metrics(self) -> dict[str, float]:
        """Return the numbers that a validation holds beside its means, by name."""
        return {
            "risk_horizon": float(self.sign.horizon),
            "risk_threshold": self.sign.threshold,
            "risk_slope": self.slope,
            "risk_shift": self.shift,
        }

    @classmethod
    def of(cls, metrics: Mapping[str, float]) -> RiskCalibration:
        """Return the calibration among the metrics of a validation.

        Raises:
            ValueError: a number is missing or not possible.
        """
        names = ("risk_horizon", "risk_threshold", "risk_slope", "risk_shift")
        if missing := [name for name in names if name not in metrics]:
            raise ValueError(f"{missing[0]} is missing")
        horizon, threshold, slope, shift = (metrics[name] for name in names)
        possible = horizon == int(horizon) >= 1 and 0 < threshold <= 1 and slope > 0
        if not possible or not math.isfinite(shift):
            values = f"{horizon:g}, {threshold:g}, {slope:g} and {shift:g}"
            raise ValueError(f"{', '.join(names)} are {values}, which is not possible")
        return cls(RiskSign(int(horizon), threshold), slope, shift)


ESCAPE_MEANING = (
    "on a warning, the action of this decision and the next ones, decisions in all, is drawn with "
    "the probabilities softmax(q_values / temperature) in place of the largest q_value"
)
"""The rule in words, for the metadata of exported policies."""


def drawn(weights: Sequence[float], uniform: float) -> int:
    """Return the index that a number from [0, 1) draws with probabilities as the weights."""
    totals = list(accumulate(weights))
    return bisect(totals, uniform * totals[-1])


@dataclass(frozen=True)
class EscapeRule:
    """When and how actions are drawn."""

    temperature: float
    """Difference of Q-values by which an action becomes e times less probable, above 0 [-]."""
    decisions: int
    """Decisions from a warning on whose actions are drawn, at least 1 [-]."""


class Escape:
    """The draws of one episode; equal episodes have equal ones."""

    def __init__(self, rule: EscapeRule) -> None:
        self._rule = rule
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._rng, self._left = np.random.default_rng(0), 0

    def due(self, *, warns: bool) -> bool:
        """Return whether the action of the next decision is drawn; call it once a decision.

        ``warns``: whether the policy warns at this decision.
        """
        self._left = self._rule.decisions if warns else max(0, self._left - 1)
        return self._left > 0

    def draw(self, values: Sequence[float]) -> int:
        """Return the index of an action drawn by its finite Q-values, (9,)."""
        largest, scale = max(values), 1 / self._rule.temperature
        # Nine numbers: sums in Python take a third of the time of numpy's.
        return drawn([math.exp((v - largest) * scale) for v in values], self._rng.random())
