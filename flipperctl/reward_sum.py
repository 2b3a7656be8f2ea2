"""The reward, the weighted sum of the configured terms, of one decision or of many at once.

In: a ``Transition``, or ``Transitions``. Out: the weighted values, checked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, RewardTerm, Shaping, Transition, Transitions
from flipperctl.api.rewards import writes
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    NonFiniteError,
    PluginError,
    PluginFailedError,
)
from flipperctl.guard import as_real, definition, plugin_label, refusal, short_repr, with_path

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
    many: bool
    """Whether the term computes many decisions at once."""

    def allows(self, value: float) -> bool:
        """Return whether the value and its weighted value are allowed; NaN is not."""
        return self.low <= value <= self.high and abs(self.weight * value) <= _LARGEST


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
        return {entry.name: entry.weight * _value(entry, t) for entry in self._terms}

    def array(self, ts: Transitions) -> FloatArray:
        """Return the weighted sum of all terms for each of M decisions, (M,) [-].

        Raises:
            NonFiniteError: a term is not finite; the text names it.
            PluginFailedError: a term raised an error, or returned no array of M numbers within its
                bounds.
        """
        total = np.zeros(len(ts))
        if len(ts):
            for entry in (e for e in self._terms if e.many):
                total += entry.weight * _values(entry, ts)
            if single := [e for e in self._terms if not e.many]:
                total += [sum(e.weight * _value(e, t) for e in single) for t in ts]
        return total

    def require_predictable(self, path: str) -> None:
        """Check that predicted decisions hold all that the terms need; ``path`` is their section.

        Raises:
            ConfigError: a term needs what predictions lack.
            PluginError: a declaration is no text.
        """
        for name, text in self.not_predicted.items():
            raise ConfigError(
                f"{path}.{name}: a search cannot predict what the term "
                f"{self.terms[name].plugin_name!r} needs: {text}"
            )

    @property
    def not_predicted(self) -> dict[str, str]:
        """What a term needs and a prediction lacks, by the name of each such term.

        Raises:
            PluginError: a declaration is no text.
        """
        found = {name: term.not_predicted for name, term in self.terms.items()}
        for name, text in found.items():
            if not isinstance(text, str):
                raise PluginError(
                    f"rewards.{name}: {plugin_label(self.terms[name])}: not_predicted is "
                    f"{short_repr(text)}; a text is allowed ({definition(self.terms[name])})"
                )
        return {name: text for name, text in found.items() if text}


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
    many = term.elementwise or writes(type(term), RewardTerm, "array")
    return _Term(name, term, float(weight), low - room, high + room, many)


def _value(entry: _Term, t: Transition) -> float:
    """Return the value of one decision by a term's form for one [-]."""
    try:
        value = entry.term(t)
    except PluginFailedError as error:
        raise with_path(error, entry.term, f"rewards.{entry.name}") from error.__cause__
    if isinstance(value, np.float64):
        value = value.item()
    elif type(value) is not float:
        value = _to_float(entry.name, entry.term, value, t)
    if not entry.allows(value):
        raise _value_error(entry, value, t, "__call__")
    return value


def _values(entry: _Term, ts: Transitions) -> FloatArray:
    """Return the values of M decisions by a term's form for many, (M,) [-]."""
    try:
        found: object = entry.term.array(ts)
    except PluginFailedError as error:
        raise with_path(error, entry.term, f"rewards.{entry.name}") from error.__cause__
    values = _checked_array(entry.name, entry.term, found, len(ts))
    # The extremes are NaN if one of the values is.
    if not (entry.allows(float(values.min())) and entry.allows(float(values.max()))):
        index = next(i for i, value in enumerate(values.tolist()) if not entry.allows(value))
        raise _value_error(entry, float(values[index]), ts[index], "array")
    return values


def _checked_array(name: str, term: RewardTerm, values: object, count: int) -> FloatArray:
    """Return what ``array`` returned, if it is an array of ``count`` real numbers."""
    if isinstance(values, np.ndarray):
        if values.dtype.kind in "fiu" and values.shape == (count,):
            return values
        what = f"an array of {values.dtype} and shape {values.shape}"
    else:
        what = short_repr(values)
    raise refusal(
        term,
        "array",
        f"returned {what} as rewards.{name}; an array of floats of shape ({count},) is allowed",
        PluginFailedError,
    )


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


def _value_error(entry: _Term, value: float, t: Transition, method: str) -> FlipperctlError:
    """Return the exception for a value that is not finite, too large or out of its bounds."""
    name, term, part = entry.name, entry.term, entry.weight * value
    module, qualname = type(term).__module__, type(term).__qualname__
    where = f"rewards.{name}: the term {term.plugin_name!r} ({module}.{qualname}): {method}"
    at = f"at time {t.after.time:.2f} s"
    if not math.isfinite(part):
        weighted = "" if not math.isfinite(value) else f", times its weight {term.weight:g},"
        return NonFiniteError(
            f"{where} returned {value}{weighted} {at}; a finite number is allowed "
            f"({definition(term, method)})"
        )
    if abs(part) > _LARGEST:
        return PluginFailedError(
            f"{where} returned {value:g}, times its weight {term.weight:g}, {at}; at most "
            f"{_LARGEST:g} is allowed, since the learner sums in single precision "
            f"({definition(term, method)})"
        )
    low, high = term.bounds
    return PluginFailedError(
        f"{where} returned {value:g} {at}; its bounds say {low:g} to {high:g} "
        f"({definition(term, method)})"
    )


def paying_terms(terms: Mapping[str, RewardTerm]) -> list[str]:
    """Return the names of the terms whose rewards count in a return.

    Potential-based shaping is left out: its discounted sum is the same for every behaviour, but
    the plain sum is not.
    """
    return [name for name, term in terms.items() if not isinstance(term, Shaping)]
