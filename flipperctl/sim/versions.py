"""Versions of the libraries that affect results, and how many samples a duration has."""

from __future__ import annotations

import math
from collections.abc import Mapping

from flipperctl.api import SAMPLE_PERIOD, Engine
from flipperctl.plugging.guard import naming, refusal, short_repr

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
    with naming(engine, "versions"):  # the returned object's code may fail too
        answer: object = engine.versions()
        versions = dict(answer) if isinstance(answer, Mapping) else {}
    texts = all(isinstance(text, str) for item in versions.items() for text in item)
    if not (isinstance(answer, Mapping) and texts):
        text = f"returned {short_repr(answer)}; allowed: a mapping of names to texts"
        raise refusal(engine, "versions", text)
    return versions
