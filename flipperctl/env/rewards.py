"""The reward, the weighted sum of the configured terms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import NamedTuple

from flipperctl.api import RewardTerm, Transition
from flipperctl.env.numbers import as_real
from flipperctl.errors import FlipperctlError, NonFiniteError, PluginError, PluginFailedError
from flipperctl.guard import definition, plugin_label, refusal, short_repr, with_path

_ROUNDING = 1e-9
"""Tolerance of a term's bounds for rounding, relative to bounds above 1 [-]."""
_LARGEST = 1e30
"""Largest weighted value [-]; the learner's sums in single precision overflow at 3e38."""


class _Term(NamedTuple):
    """A reward term with its weight and bounds as floats."""

    name: str
    term: RewardTerm
    weight: float
    low: float
    """Declared lower bound, less a tolerance for rounding [-]."""
    high: float
    """Declared upper bound, plus a tolerance for rounding [-]."""


class RewardSum:
    """Computes the weighted value of each term."""

    def __init__(self, terms: Mapping[str, RewardTerm]) -> None:
        """Prepare the terms.

        Raises:
            PluginError: the bounds or the weight of a term are not valid.
        """
        self.terms = dict(terms)
        self._terms = [_prepare(name, term) for name, term in terms.items()]

    def __call__(self, t: Transition) -> dict[str, float]:
        """Return the weighted value of each term by its name [-].

        Raises:
            NonFiniteError: a term is not finite; the text names it.
            PluginFailedError: a term raised an error, or returned no number within its bounds.
        """
        parts = {}
        for name, term, weight, low, high in self._terms:
            try:
                value = term(t)
            except PluginFailedError as error:
                raise with_path(error, term, f"rewards.{name}") from error.__cause__
            if type(value) is not float:
                value = _to_float(name, term, value, t)
            part = weight * value
            if not (low <= value <= high and -_LARGEST <= part <= _LARGEST):  # false for NaN
                raise _value_error(name, term, value, part, t)
            parts[name] = part
        return parts


def _prepare(name: str, term: RewardTerm) -> _Term:
    try:
        bounds, weight = term.bounds, term.weight
    except PluginError as error:
        raise with_path(error, term, f"rewards.{name}") from error.__cause__
    pair = isinstance(bounds, tuple | list) and len(bounds) == 2
    if not (pair and all(isinstance(b, Real) for b in bounds) and bounds[0] <= bounds[1]):
        raise PluginError(
            f"rewards.{name}: {plugin_label(term)}: bounds are {short_repr(bounds)}; "
            f"the least and the largest unweighted value are allowed, in this order "
            f"({definition(term)})"
        )
    if not isinstance(weight, Real):
        raise PluginError(
            f"rewards.{name}: {plugin_label(term)}: weight is {short_repr(weight)}; "
            f"a number is allowed ({definition(term)})"
        )
    low, high = map(float, bounds)
    room = _ROUNDING * max(1.0, *(abs(b) for b in (low, high) if math.isfinite(b)), 0.0)
    return _Term(name, term, float(weight), low=low - room, high=high + room)


def _to_float(name: str, term: RewardTerm, value: object, t: Transition) -> float:
    """Return a real number of Python or numpy, or an array or tensor of one number, as a float."""
    if (number := as_real(value, term)) is not None:
        return float(number)
    raise refusal(
        term,
        "__call__",
        f"returned {short_repr(value)} at time {t.after.time:.2f} s as rewards.{name}; "
        "a finite number is allowed",
        PluginFailedError,
    )


def _value_error(
    name: str, term: RewardTerm, value: float, part: float, t: Transition
) -> FlipperctlError:
    """Return the exception for a value that is not finite, too large or out of its bounds."""
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
