"""What an operator's browser asks of flippers and belts, checked and made into commands.

In: messages of ``drive.html`` from any thread. Out: a ``Command`` for each tick. Without news for
``LOST`` the flippers hold where they are and the belts stand.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from flipperctl.api import Command, Robot, RobotState
from flipperctl.core.targets import TargetRule, alike, angles_of, by_joint

LOST = 0.2
"""Time without a message after which the operator counts as gone [s]."""
_Share = Annotated[float, Field(ge=-1, le=1)]
_Steps = Annotated[int, Field(ge=-1_000_000, le=1_000_000)]
_Number = TypeVar("_Number")
_PerJoint = Annotated[tuple[_Number, ...], Field(min_length=2, max_length=4)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Asked(_Message):
    """What the operator's keys, buttons or sticks ask for now."""

    kind: Literal["hands"]
    at: Annotated[float, Field(ge=0, le=1e12)]
    """Time of the browser [ms]."""
    rates: _PerJoint[_Share]
    """Held rate of each joint, (J,), as a share of its speed, up positive [-]."""
    belts: _Share
    """Share of the belts' speed [-]."""
    steps: _PerJoint[_Steps]
    """Steps of each joint up minus steps down since the page was opened, (J,) [-]."""


class Do(_Message):
    """A button that is no motion."""

    kind: Literal["do"]
    what: Literal["begin", "again", "next", "take", "release"]


class Theme(_Message):
    """How the scene is to be drawn."""

    kind: Literal["theme"]
    dark: bool
    software: bool
    """Whether the browser has no graphics card, to which shadows are slow."""


class Answers(_Message):
    """Answers to the six questions of NASA-TLX."""

    kind: Literal["answers"]
    values: Annotated[
        tuple[Annotated[int, Field(ge=0, le=100)], ...], Field(min_length=6, max_length=6)
    ]


_MESSAGES: TypeAdapter[Asked | Do | Answers | Theme] = TypeAdapter(
    Annotated[Asked | Do | Answers | Theme, Field(discriminator="kind")]
)


def parse(message: str) -> Asked | Do | Answers | Theme:
    """Return a message of the page; ``ValueError`` if it is none."""
    return _MESSAGES.validate_json(message, strict=True)


class Hands:
    """The newest wishes of the one browser that drives."""

    def __init__(self, robot: Robot, period: float, *, helped: bool = False) -> None:
        """Command ``robot`` every ``period`` [s]; ``helped``: whether a policy helps."""
        self._robot, self._period = robot, period
        self._rule = TargetRule(window=robot.angle_step, limit=robot.angle_limit)
        self._lock = threading.Lock()
        self._asked: Asked | None = None
        self._came = 0.0
        self._joints = len(robot.joints)
        self._steps: tuple[int, ...] = (0,) * self._joints
        self._held: tuple[float, ...] | None = None
        self._helped = helped
        self.owned = [not helped, not helped]
        """Whether the operator commands the front and the rear pair, and no policy."""

    def hear(self, request: Asked) -> None:
        """Take a message; steps that were pressed while nobody was present do not count.

        ``ValueError`` if it is of another number of joints.
        """
        if not len(request.rates) == len(request.steps) == self._joints:
            raise ValueError(f"rates and steps of {self._joints} joints are allowed")
        with self._lock:
            if not self.present:
                self._steps = request.steps
            self._asked, self._came = request, time.monotonic()

    @property
    def present(self) -> bool:
        """Whether a browser drives now."""
        return self._asked is not None and time.monotonic() - self._came <= LOST

    def release(self) -> None:
        """Give both flipper pairs back to the policy that helps."""
        self.owned = [not self._helped, not self._helped]

    def begin(self) -> None:
        """Forget what was pressed until now, as before a drive begins."""
        with self._lock:
            if self._asked is not None:
                self._steps = self._asked.steps

    def leave(self) -> None:
        """Hold everything: the browser is gone, or another one drives."""
        with self._lock:
            self._asked = None

    def command(
        self,
        targets: Sequence[float],
        state: RobotState,
        proposed: Sequence[float],
    ) -> tuple[Command, float | None]:
        """Return the next command, and the time of the message that it is made from [ms].

        ``targets``: last targets, (J,) [rad]; ``proposed``: turns of this tick by a policy that
        helps, (J,) [angle steps]. The time is None while flippers and belts are held since nobody
        drives.
        """
        with self._lock:
            request, steps = self._asked, self._steps
            # Without a driver, the flippers stay where they were when this was noticed.
            if request is None or not self.present:
                self._held = self._held or angles_of(state)
                return self._commanded(self._held, 0.0), None
            self._held = None
            self._steps = now = request.steps
        # Pressed steps and held rates add up; the pair of a flipper that is turned belongs to the
        # operator from then on.
        robot, half = self._robot, self._joints // 2
        wanted = [
            (step - before) * robot.angle_step + rate * robot.flipper_speed * self._period
            for step, before, rate in zip(now, steps, request.rates, strict=True)
        ]
        for end, pair in enumerate((wanted[:half], wanted[half:])):
            self.owned[end] |= any(pair)
        turns = [
            turn if mine else proposal * robot.angle_step
            for turn, mine, proposal in zip(
                wanted, alike(self.owned, self._joints), proposed, strict=True
            )
        ]
        turned = self._rule.next_targets(targets, angles_of(state), turns)
        # A flipper that nobody turns keeps its target.
        new = [new if turn else old for new, old, turn in zip(turned, targets, turns, strict=True)]
        return self._commanded(new, request.belts), request.at

    def _commanded(self, angles: Sequence[float], belts: float) -> Command:
        front, rear = map(float, self.owned)
        return Command(**by_joint(angles), belts=belts, took_front=front, took_rear=rear)
