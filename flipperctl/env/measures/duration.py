"""Measures of an episode's duration."""

from typing import ClassVar

from flipperctl.api import Transition


class Decisions:
    """Number of decisions in the episode [-]."""

    name: ClassVar[str] = "decisions"
    heading: ClassVar[str] = ""
    digits: ClassVar[int] = 0
    reached_only: ClassVar[bool] = False

    def __init__(self) -> None:
        self.value = 0

    def add(self, t: Transition) -> None:
        """Count one decision."""
        self.value += 1


class Time:
    """Simulated time from the start to the end of the episode [s]."""

    name: ClassVar[str] = "t_cost"
    heading: ClassVar[str] = "t_cost [s]"
    digits: ClassVar[int] = 1
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Store the time after the decision."""
        self.value = t.after.time
