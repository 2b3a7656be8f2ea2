"""How long an episode took."""

from typing import ClassVar

from flipperctl.api import Transition


class Decisions:
    """Number of decisions [-]."""

    name: ClassVar[str] = "decisions"
    heading: ClassVar[str] = ""
    digits: ClassVar[int] = 0
    reached_only: ClassVar[bool] = False

    def __init__(self) -> None:
        self.value = 0

    def add(self, t: Transition) -> None:
        """Count one more."""
        self.value += 1


class Time:
    """From the start to the end of the episode [s]."""

    name: ClassVar[str] = "t_cost"
    heading: ClassVar[str] = "t_cost [s]"
    digits: ClassVar[int] = 1
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Take the time after the decision."""
        self.value = t.after.time
