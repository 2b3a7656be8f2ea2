"""What a measure of an episode is."""

from __future__ import annotations

from typing import ClassVar, Protocol

from flipperctl.api import Transition


class Measure(Protocol):
    """One number of one episode, gathered decision by decision."""

    name: ClassVar[str]
    """Its column in every file, and its key in JSON."""
    heading: ClassVar[str]
    """In tables, with its unit; empty where tables leave it out."""
    digits: ClassVar[int]
    """Decimals in tables."""
    reached_only: ClassVar[bool]
    """Whether it is compared among episodes that reached the finish only."""

    def add(self, t: Transition) -> None:
        """Take in one decision."""

    @property
    def value(self) -> float:
        """The number so far."""
