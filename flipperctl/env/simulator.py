"""The scene of an episode in a simulator of its own, for controllers that look ahead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flipperctl.api import Outcome, RobotGeometry, RobotState
from flipperctl.env.drive import Drive


class SceneSimulator:
    """See ``flipperctl.api.Simulator``; its world is built when it is first used."""

    def __init__(self, make: Callable[[], Drive], tell: Callable[[float], None]) -> None:
        self._make, self._tell = make, tell
        self._made: Drive | None = None

    @property
    def _drive(self) -> Drive:
        if self._made is None:
            self._made = self._make()
        return self._made

    @property
    def state(self) -> RobotState:
        """The robot now."""
        return self._drive.state

    @property
    def robot(self) -> RobotGeometry:
        """Its geometry."""
        return self._drive.robot

    @property
    def speed(self) -> float:
        """Of the belts [m/s]."""
        return self._drive.robot.track_speed

    @property
    def finish(self) -> float:
        """X that the chassis centre must pass [m]."""
        return self._drive.ends.finish

    def step(self, action: int) -> Outcome | None:
        """One decision."""
        return self._drive.decide(action)

    def save(self) -> Any:
        """For ``load``."""
        return self._drive.save()

    def load(self, saved: Any) -> None:
        """Go back to what ``save`` gave."""
        self._drive.load(saved)

    def restart(self) -> None:
        """Back to the start in a new world: what follows is the episode's own, bit for bit."""
        self._made = None

    def tell(self, share: float) -> None:
        """How much of a long search is done, in [0, 1]."""
        self._tell(share)
