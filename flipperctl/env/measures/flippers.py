"""Measures of the flippers' motion."""

from typing import ClassVar

from flipperctl.api import Transition


class FlipperTravel:
    """Sum of the absolute turns of both flipper pairs from decision to decision [rad]."""

    name: ClassVar[str] = "flipper_travel"
    heading: ClassVar[str] = "flipper travel [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the absolute turns over one decision."""
        before, after = t.before, t.after
        self.value += abs(after.front - before.front) + abs(after.rear - before.rear)
