"""A policy made of one function of the perception, for rules without settings."""

from __future__ import annotations

from collections.abc import Callable

from flipperctl.api import Perception, Simulator


class FunctionPolicy:
    """Decides by a function and has no memory."""

    def __init__(self, rule: Callable[[Perception], int]) -> None:
        self._rule = rule

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; the policy has no memory."""

    def act(self, p: Perception) -> int:
        """Return the action that the function returns."""
        return self._rule(p)
