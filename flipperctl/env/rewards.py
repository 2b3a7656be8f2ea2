"""The reward: the weighted sum of the configured terms."""

from __future__ import annotations

import math
from collections.abc import Mapping

from flipperctl.api import RewardTerm, Transition
from flipperctl.errors import NonFiniteError


class RewardSum:
    """Sums the terms and keeps the parts apart."""

    def __init__(self, terms: Mapping[str, RewardTerm]) -> None:
        self.terms = dict(terms)

    def __call__(self, t: Transition) -> dict[str, float]:
        """The weighted value of each term.

        Raises:
            NonFiniteError: a term is not finite; the text names it.
        """
        parts = {}
        for name, term in self.terms.items():
            value = term.weight * float(term(t))
            if not math.isfinite(value):
                raise NonFiniteError(
                    f"rewards.{name}: the term ({type(term).__module__}.{type(term).__qualname__}) "
                    f"returned {value} at time {t.after.time:.2f} s"
                )
            parts[name] = value
        return parts
