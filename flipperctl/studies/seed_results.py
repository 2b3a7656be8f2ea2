"""What ``inspect results`` asks of evaluations, and the answer.

In: folders, a measure, a price and a method to compare with. Out: the methods' rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flipperctl.api import Measure
from flipperctl.config import resolver
from flipperctl.errors import RequestError
from flipperctl.evaluation.scores import PRICE, Method
from flipperctl.evaluation.seed_folders import Evaluated, read
from flipperctl.messages import close_match
from flipperctl.studies.seed_table import MethodRow, rows

_PRICED = ("pitch_variation_100hz", "pitch_variation")
"""Measures for which ``PRICE`` is the default."""


@dataclass(frozen=True)
class Question:
    """What to compute; None stands for the default of the option of the same name."""

    against: str | None = None
    measure: str = _PRICED[0]
    price: float | None = None
    detect: float | None = None
    detect_success: float | None = None


@dataclass(frozen=True)
class Answer:
    """The methods and their rows."""

    evaluated: Evaluated
    question: Question
    label: str
    """The measure and its unit."""
    price: float
    rows: tuple[MethodRow, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "measure": self.question.measure,
            "price": self.price,
            "episodes": dict(self.evaluated.episodes),
            "notices": list(self.evaluated.notices),
            "methods": [row.to_dict() for row in self.rows],
        }


def answer(folders: Sequence[str], question: Question) -> Answer:
    """Read the folders and return the answer.

    Raises:
        RequestError: an option or a folder is wrong.
    """
    measure = _measure(question.measure)
    price = _price(question)
    _above_zero("--detect", question.detect, math.inf)
    _above_zero("--detect-success", question.detect_success, 1.0)
    found = read(folders, question.measure)
    against = _chosen(found.methods, question.against)
    table = rows(
        found.methods,
        price,
        against,
        detect=question.detect,
        detect_success=question.detect_success,
    )
    return Answer(found, question, f"{question.measure} [{measure.unit}]", price, tuple(table))


def _measure(name: str) -> type[Measure]:
    found = resolver.get(Measure.kind, name, "--measure")
    assert issubclass(found, Measure)
    if found.better != "lower":
        raise RequestError(f"--measure {name}: a measure of which less is better is allowed")
    return found


def _price(question: Question) -> float:
    if question.price is not None:
        _above_zero("--price", question.price, math.inf)
        return question.price
    if question.measure in _PRICED:
        return PRICE
    raise RequestError(
        f"--price: {question.measure} has no default; the price of an episode that is not reached, "
        "in the measure's unit, is needed"
    )


def _above_zero(option: str, value: float | None, most: float) -> None:
    if value is not None and not (0 < value <= most and math.isfinite(value)):
        allowed = "a number above 0" if math.isinf(most) else f"a number in (0, {most:g}]"
        raise RequestError(f"{option}: {value:g}; {allowed} is allowed")


def _chosen(methods: Sequence[Method], name: str | None) -> Method:
    names = [method.name for method in methods]
    if name is None:
        return methods[0]
    if name not in names:
        raise RequestError(
            f"--against: there is no method {name!r}{close_match(name, names)}; "
            f"known: {', '.join(names)}"
        )
    return methods[names.index(name)]
