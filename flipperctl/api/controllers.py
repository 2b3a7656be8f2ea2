"""Controllers, the policies that they build, and the simulator for those who look ahead."""

from __future__ import annotations

import warnings
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


class Policy(Protocol):
    """Decides, decision after decision; may remember what it perceived in the episode.

    Trained networks, exported files, rules, planners and people who drive are all policies.
    """

    def reset(self, simulator: Simulator, /) -> None:
        """Begin an episode; ``simulator`` is its scene, for those who look ahead."""

    def act(self, p: Perception, /) -> int:
        """Return the index into ``ACTIONS`` of the next action."""


class Controller(Plugin):
    """The frozen settings of a rule, or of something that remembers or plans.

    A rule without memory writes ``act``. Everything else writes ``build``, which makes an object
    that may keep state, as a network's settings build its module.
    """

    kind: ClassVar[str] = "controller"
    searches_first: ClassVar[bool] = False
    """Whether ``reset`` searches the scene, which may take long."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse what can never decide."""
        if cls.act is Controller.act and cls.build is Controller.build:
            raise TypeError(f"controller {cls.__name__} needs a method act(p) or build()")
        if cls.begin is not Controller.begin:
            warnings.warn(
                f"controller {cls.__name__}: begin is deprecated since flipperctl 0.2; "
                "write build(), which returns an object with reset and act",
                DeprecationWarning,
                stacklevel=2,
            )
            cls.searches_first = True

    def build(self) -> Policy:
        """Return a policy with these settings; ``reset`` begins each of its episodes."""
        return Rule(self)

    def act(self, p: Perception) -> int:
        """Return the index into ``ACTIONS``, from this perception alone."""
        raise TypeError(f"controller {type(self).__name__} decides through build() only")

    def begin(self, simulator: Simulator) -> None:
        """Begin an episode; deprecated, see ``build``."""


class Rule:
    """A controller without memory as a policy."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; only controllers written for version 0.1 hear of it."""
        self._controller.begin(simulator)

    def act(self, p: Perception) -> int:
        """Return what the controller decides."""
        return self._controller.act(p)


ControllerT = TypeVar("ControllerT", bound=Controller)


def controller(name: str) -> Callable[[type[ControllerT]], type[ControllerT]]:
    """Register a ``Controller``; choose it with ``--controller <name>``."""
    return register(Controller, name)
