"""The return by which policies are compared: the reward terms without potential-based shaping."""

from __future__ import annotations

from collections.abc import Mapping

from flipperctl.api import RewardTerm, Shaping


def paying_terms(terms: Mapping[str, RewardTerm]) -> list[str]:
    """Return the names of the terms whose rewards count in a return.

    Potential-based shaping is left out: its discounted sum is the same for every behaviour, but
    the plain sum is not.
    """
    return [name for name, term in terms.items() if not isinstance(term, Shaping)]
