"""The protocol of a measure of an episode."""

from __future__ import annotations

from typing import ClassVar, Protocol

from flipperctl.api import Transition


class Measure(Protocol):
    """One number of one episode, updated at each decision."""

    name: ClassVar[str]
    """Name of the column in files and of the key in JSON."""
    heading: ClassVar[str]
    """Heading in tables, with its unit; empty if tables omit the measure."""
    digits: ClassVar[int]
    """Number of decimals in tables."""
    reached_only: ClassVar[bool]
    """Whether only episodes that reached the finish are compared by it."""

    def add(self, t: Transition) -> None:
        """Update the measure with one decision."""

    @property
    def value(self) -> float:
        """Value so far, in the unit of the heading."""
