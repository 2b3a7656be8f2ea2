"""Controllers, and the simulator that those who look ahead are given."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import Outcome, Perception, RobotGeometry, RobotState


class Simulator(Protocol):
    """The scene of an episode, for controllers that look ahead; no real robot has one."""

    @property
    def state(self) -> RobotState:
        """The robot now."""

    @property
    def robot(self) -> RobotGeometry:
        """Its geometry."""

    @property
    def speed(self) -> float:
        """Of its belts [m/s]."""

    @property
    def finish(self) -> float:
        """X that the chassis centre must pass [m]."""

    def step(self, action: int) -> Outcome | None:
        """One decision; None while the episode goes on."""

    def save(self) -> Any:
        """The moment, for ``load``."""

    def load(self, saved: Any) -> None:
        """Go back to a moment.

        The engine's contact impulses are not restored, so that a path through loaded moments
        differs a little from the same actions in one go.
        """

    def restart(self) -> None:
        """Back to the start: the same actions now lead to the episode's own states, exactly."""

    def tell(self, share: float) -> None:
        """Say how much of a long search is done, in [0, 1]."""


class Controller(Plugin, ABC):
    """A rule that maps what the robot perceives to an action."""

    kind: ClassVar[str] = "controller"

    def begin(self, simulator: Simulator) -> None:  # for the few that need it
        """An episode begins; ``simulator`` is its scene. Most rules do nothing here."""

    @abstractmethod
    def act(self, p: Perception) -> int:
        """Index into ``ACTIONS``."""


ControllerT = TypeVar("ControllerT", bound=Controller)


def controller(name: str) -> Callable[[type[ControllerT]], type[ControllerT]]:
    """Register a ``Controller``; choose it with ``--controller <name>``."""
    return register(Controller, name)
