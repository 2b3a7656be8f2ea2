"""How much the flippers turned."""

from typing import ClassVar

from flipperctl.api import Transition


class FlipperTravel:
    """The angle that both pairs turned, from decision to decision [rad]."""

    name: ClassVar[str] = "flipper_travel"
    heading: ClassVar[str] = "flipper travel [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the turns of one decision."""
        before, after = t.before, t.after
        self.value += abs(after.front - before.front) + abs(after.rear - before.rear)
