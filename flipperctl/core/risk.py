"""The sign that an episode is about to fail: a probability, and the threshold of a warning.

In: the risk at a decision, as a policy's network estimates it. Out: whether it is a warning.
Simulator and robot share this definition.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

MEANING = (
    "risk is the probability that the episode ends overturned, stuck or out of time within the "
    "next horizon decisions, the one that follows included; a warning is a risk of threshold or "
    "more"
)
"""The sign in words, for the metadata of exported policies."""


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
