"""A policy that is one function of what is perceived, for rules that need no settings."""

from __future__ import annotations

from collections.abc import Callable

from flipperctl.api import Perception, Simulator


class FunctionPolicy:
    """Decides by a function; remembers nothing."""

    def __init__(self, rule: Callable[[Perception], int]) -> None:
        self._rule = rule

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; there is nothing to forget."""

    def act(self, p: Perception) -> int:
        """Return what the function returns."""
        return self._rule(p)
