"""The reward: the weighted sum of the configured terms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import NamedTuple

from flipperctl.api import RewardTerm, Transition
from flipperctl.errors import FlipperctlError, NonFiniteError, PluginError, PluginFailedError
from flipperctl.guard import called, definition, fault, refusal, shown

_ROUNDING = 1e-9
"""Of a value at its bounds, relative to them where they are large."""
_LARGEST = 1e30
"""Of a weighted value: the learner's sums in single precision end at 3e38."""


class _Term(NamedTuple):
    """A term as the sum needs it at each decision."""

    name: str
    term: RewardTerm
    weight: float
    low: float
    """The declared bounds, with room for rounding."""
    high: float


class RewardSum:
    """Sums the terms and keeps the parts apart."""

    def __init__(self, terms: Mapping[str, RewardTerm]) -> None:
        """Raise ``PluginError`` for a term whose bounds or weight are none."""
        self.terms = dict(terms)
        self._terms = [_prepared(name, term) for name, term in terms.items()]

    def __call__(self, t: Transition) -> dict[str, float]:
        """The weighted value of each term.

        Raises:
            NonFiniteError: a term is not finite; the text names it.
            PluginFailedError: a term raised, returned no number, or one beyond its bounds.
        """
        parts = {}
        for name, term, weight, low, high in self._terms:
            try:
                value = term(t)
            except BaseException as error:
                raise fault(error, term, "__call__", while_=f" (rewards.{name})") from error
            if type(value) is not float:
                value = _number(name, term, value, t)
            part = weight * value
            if not (low <= value <= high and -_LARGEST <= part <= _LARGEST):  # a NaN is not
                raise _beyond(name, term, value, part, t)
            parts[name] = part
        return parts


def _prepared(name: str, term: RewardTerm) -> _Term:
    try:
        bounds, weight = term.bounds, term.weight
    except BaseException as error:
        raise fault(error, term, "bounds", PluginError, while_=f" (rewards.{name})") from error
    pair = isinstance(bounds, tuple | list) and len(bounds) == 2
    if not (pair and all(isinstance(b, Real) for b in bounds) and bounds[0] <= bounds[1]):
        raise PluginError(
            f"rewards.{name}: {called(term)}: bounds are {shown(bounds)}; the least and the "
            f"largest unweighted value are allowed, in this order ({definition(term)})"
        )
    if not isinstance(weight, Real):
        raise PluginError(
            f"rewards.{name}: {called(term)}: weight is {shown(weight)}; a number is allowed "
            f"({definition(term)})"
        )
    low, high = map(float, bounds)
    room = _ROUNDING * max(1.0, *(abs(b) for b in (low, high) if math.isfinite(b)), 0.0)
    return _Term(name, term, float(weight), low - room, high + room)


def _number(name: str, term: RewardTerm, value: object, t: Transition) -> float:
    """A value as a float: Python's and numpy's real numbers, arrays and tensors of one number."""
    if getattr(value, "shape", None) == ():
        value = value.item()  # type: ignore[attr-defined]  # what has that shape has it
    if isinstance(value, Real):
        return float(value)
    raise refusal(
        term,
        "__call__",
        f"returned {shown(value)} at time {t.after.time:.2f} s as rewards.{name}; "
        "a finite number is allowed",
        PluginFailedError,
    )


def _beyond(
    name: str, term: RewardTerm, value: float, part: float, t: Transition
) -> FlipperctlError:
    module, qualname = type(term).__module__, type(term).__qualname__
    where = f"rewards.{name}: the term {term.plugin_name!r} ({module}.{qualname}): __call__"
    at = f"at time {t.after.time:.2f} s"
    if not math.isfinite(part):
        weighted = "" if not math.isfinite(value) else f", times its weight {term.weight:g},"
        return NonFiniteError(
            f"{where} returned {value}{weighted} {at}; a finite number is allowed "
            f"({definition(term, '__call__')})"
        )
    if abs(part) > _LARGEST:
        return PluginFailedError(
            f"{where} returned {value:g}, times its weight {term.weight:g}, {at}; at most "
            f"{_LARGEST:g} is allowed, since the learner sums in single precision "
            f"({definition(term, '__call__')})"
        )
    low, high = term.bounds
    return PluginFailedError(
        f"{where} returned {value:g} {at}; its bounds say {low:g} to {high:g} "
        f"({definition(term, '__call__')})"
    )
