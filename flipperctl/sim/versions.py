"""Versions of the libraries that affect results, and how many samples a duration has."""

from __future__ import annotations

import math

from flipperctl.api import SAMPLE_PERIOD, Engine
from flipperctl.plugging.checked import require

_EXACT = 1e-9  # part of a sample that is an error of rounding [-]


def samples_in(duration: float) -> int:
    """Return the number of samples of a duration [s], rounded up."""
    return math.ceil(duration / SAMPLE_PERIOD - _EXACT)


def simulated(duration: float) -> float:
    """Return how long a duration is simulated [s]: itself if it has whole samples, or longer."""
    samples = samples_in(duration)
    longer = samples - duration / SAMPLE_PERIOD > _EXACT
    return samples * SAMPLE_PERIOD if longer else duration


def engine_versions(engine: Engine) -> dict[str, str]:
    """Return the versions of the libraries that affect the engine's results."""
    return dict(require(engine, "versions", engine.versions()))
