"""The reward, the weighted sum of the configured terms, of one decision or of many at once.

In: a ``Transition``, or ``Transitions``. Out: the weighted values, checked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

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
from flipperctl.plugging.guard import as_real, definition, naming, plugin_label, refusal, short_repr

_ROUNDING = 1e-9
"""Tolerance of a term's bounds for rounding, relative to bounds above 1 [-]."""
_LARGEST = 1e30
"""Largest weighted value [-]; the learner's sums in single precision overflow at 3e38."""


class RewardSum:
    """Computes the weighted value of each term."""

    def __init__(self, terms: Mapping[str, RewardTerm]) -> None:
        """Prepare the terms.

        Raises:
            PluginError: the bounds or the weight of a term are not valid.
        """
        self.terms = dict(terms)
        self._terms = [_Term(name, term) for name, term in terms.items()]

    def __call__(self, t: Transition) -> dict[str, float]:
        """Return the weighted value of each term by its name [-].

        Raises:
            NonFiniteError: a term is not finite; the text names it.
            PluginFailedError: a term returned no number within its bounds.
        """
        return {entry.name: entry.weight * entry.value(t) for entry in self._terms}

    def array(self, ts: Transitions) -> FloatArray:
        """Return the weighted sum of all terms for each of M decisions, (M,) [-].

        Raises:
            NonFiniteError: a term is not finite; the text names it.
            PluginFailedError: a term returned no array of M numbers within its bounds.
        """
        total = np.zeros(len(ts))
        if len(ts):
            for entry in (e for e in self._terms if e.many):
                total += entry.weight * entry.values(ts)
            if single := [e for e in self._terms if not e.many]:
                total += [sum(e.weight * e.value(t) for e in single) for t in ts]
        return total

    def require_predictable(self, path: str) -> None:
        """Raise ``ConfigError`` if a term needs what predicted decisions lack.

        ``path`` is the section of the terms.
        """
        for name, text in self.not_predicted.items():
            raise ConfigError(
                f"{path}.{name}: a search cannot predict what the term "
                f"{self.terms[name].plugin_name!r} needs: {text}"
            )

    @property
    def not_predicted(self) -> dict[str, str]:
        """What a term needs and a prediction lacks, by the name of each such term."""
        texts = {name: term.not_predicted for name, term in self.terms.items()}
        for name, text in texts.items():
            if not isinstance(text, str):
                raise _undeclared(name, self.terms[name], "not_predicted is", text, "a text is")
        return {name: text for name, text in texts.items() if text}


class _Term:
    """A reward term with its weight and bounds as floats."""

    def __init__(self, name: str, term: RewardTerm) -> None:
        self.name, self.term = name, term
        with naming(term, "bounds", PluginError):
            bounds: Any = term.bounds
            weight: Any = term.weight
        pair = isinstance(bounds, tuple | list) and len(bounds) == 2
        if not (pair and all(isinstance(b, Real) for b in bounds) and bounds[0] <= bounds[1]):
            allowed = "the least and the largest unweighted value are"
            raise _undeclared(name, term, "bounds are", bounds, allowed, ", in this order")
        if not isinstance(weight, Real):
            raise _undeclared(name, term, "weight is", weight, "a number is")
        self.weight = float(weight)
        low, high = map(float, bounds)
        room = _ROUNDING * max(1.0, *(abs(b) for b in (low, high) if math.isfinite(b)), 0.0)
        self._low, self._high = low - room, high + room
        self.many = term.elementwise or writes(type(term), RewardTerm, "array")
        """Whether the term computes many decisions at once."""

    def value(self, t: Transition) -> float:
        """Return the checked value of one decision by the term's form for one [-]."""
        returned = self.term(t)
        value = float(returned) if isinstance(returned, float) else self._to_float(returned, t)
        if not self._allows(value):
            raise self._value_error(value, t, "__call__")
        return value

    def values(self, ts: Transitions) -> FloatArray:
        """Return the checked values of M decisions by the term's form for many, (M,) [-]."""
        paid: Any = self.term.array(ts)
        is_array = isinstance(paid, np.ndarray)
        if not (is_array and paid.dtype.kind in "fiu" and paid.shape == (len(ts),)):
            what = f"an array of {paid.dtype} and shape {paid.shape}" if is_array else ""
            raise refusal(
                self.term,
                "array",
                f"returned {what or short_repr(paid)} as rewards.{self.name}; an array of floats "
                f"of shape ({len(ts)},) is allowed",
            )
        # The extremes are NaN if one of the values is.
        if not (self._allows(float(paid.min())) and self._allows(float(paid.max()))):
            index = next(i for i, value in enumerate(paid.tolist()) if not self._allows(value))
            raise self._value_error(float(paid[index]), ts[index], "array")
        values: FloatArray = paid
        return values

    def _allows(self, value: float) -> bool:
        """Return whether the value and its weighted value are allowed; NaN is not."""
        return self._low <= value <= self._high and abs(self.weight * value) <= _LARGEST

    def _to_float(self, value: object, t: Transition) -> float:
        """Return a number of Python or numpy, or an array or tensor of one number, as a float."""
        if (number := as_real(value)) is not None:
            return float(number)
        raise refusal(
            self.term,
            "__call__",
            f"returned {short_repr(value)} at time {t.after.time:.2f} s as rewards.{self.name}; "
            "a finite number is allowed",
        )

    def _value_error(self, value: float, t: Transition, method: str) -> FlipperctlError:
        """Return the exception for a value that is not finite, too large or out of its bounds."""
        low, high = self.term.bounds
        weighted = self.weight * value
        text = (
            f"returned {value:g} at time {t.after.time:.2f} s as rewards.{self.name}, "
            f"{weighted:g} when weighted; a finite number from {low:g} to {high:g} is allowed, and "
            f"at most {_LARGEST:g} when weighted"
        )
        kind = PluginFailedError if math.isfinite(weighted) else NonFiniteError
        return refusal(self.term, method, text, kind)


def _undeclared(
    name: str, term: RewardTerm, what: str, value: object, allowed: str, more: str = ""
) -> PluginError:
    return PluginError(
        f"rewards.{name}: {plugin_label(term)}: {what} {short_repr(value)}; {allowed} "
        f"allowed{more} ({definition(term)})"
    )


def paying_terms(terms: Mapping[str, RewardTerm]) -> list[str]:
    """Return the names of the terms whose rewards count in a return.

    Potential-based shaping is left out: its discounted sum is the same for every behaviour, but
    the plain sum is not.
    """
    return [name for name, term in terms.items() if not isinstance(term, Shaping)]
