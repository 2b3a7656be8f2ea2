"""What an operator's browser asks of flippers and belts, checked and made into commands.

In: messages of ``drive.html`` from any thread. Out: a ``Command`` for each tick. Without news for
``LOST`` the flippers hold where they are and the belts stand.
"""

from __future__ import annotations

import threading
import time
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from flipperctl.api import Command, Robot, RobotState
from flipperctl.core.targets import TargetRule

LOST = 0.2
"""Time without a message after which the operator counts as gone [s]."""
_Share = Annotated[float, Field(ge=-1, le=1)]
_Steps = Annotated[int, Field(ge=-1_000_000, le=1_000_000)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Asked(_Message):
    """What the operator's keys, buttons or sticks ask for now."""

    kind: Literal["hands"]
    at: Annotated[float, Field(ge=0, le=1e12)]
    """Time of the browser [ms]."""
    front: _Share
    """Held rate of the front flippers, as a share of their speed, up positive [-]."""
    rear: _Share
    belts: _Share
    """Share of the belts' speed [-]."""
    front_steps: _Steps
    """Steps up minus steps down since the page was opened [-]."""
    rear_steps: _Steps


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
        self._steps = 0, 0
        self._held: tuple[float, float] | None = None
        self._helped = helped
        self.owned = [not helped, not helped]
        """Whether the operator commands the front and the rear flippers, and no policy."""

    def hear(self, request: Asked) -> None:
        """Take a message; steps that were pressed while nobody was present do not count."""
        with self._lock:
            if not self.present:
                self._steps = request.front_steps, request.rear_steps
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
                self._steps = self._asked.front_steps, self._asked.rear_steps

    def leave(self) -> None:
        """Hold everything: the browser is gone, or another one drives."""
        with self._lock:
            self._asked = None

    def command(
        self,
        targets: tuple[float, float],
        state: RobotState,
        proposed: tuple[float, float] = (0, 0),
    ) -> tuple[Command, float | None]:
        """Return the next command, and the time of the message that it is made from [ms].

        ``targets``: last targets [rad]; ``proposed``: turns of this tick by a policy that helps.
        The time is None while flippers and belts are held since nobody drives.
        """
        with self._lock:
            request, steps = self._asked, self._steps
            # Without a driver, the flippers stay where they were when this was noticed.
            if request is None or not self.present:
                self._held = self._held or (state.front, state.rear)
                return Command(*self._held, 0.0, *self._took()), None
            self._held = None
            self._steps = now = request.front_steps, request.rear_steps
        robot = self._robot
        turns = []
        rates = request.front, request.rear
        # Pressed steps and held rates add up; a pair that is turned belongs to the operator from
        # then on.
        for i, (step, before, rate) in enumerate(zip(now, steps, rates, strict=True)):
            turn = (step - before) * robot.angle_step
            turn += rate * robot.flipper_speed * self._period
            if turn:
                self.owned[i] = True
            turns.append(turn if self.owned[i] else proposed[i] * robot.angle_step)
        angles = state.front, state.rear
        turned = self._rule.next_targets(targets, angles, turns)
        # A pair that nobody turns keeps its target.
        front, rear = (
            new if turn else old for new, old, turn in zip(turned, targets, turns, strict=True)
        )
        return Command(front, rear, request.belts, *self._took()), request.at

    def _took(self) -> tuple[float, float]:
        front, rear = map(float, self.owned)
        return front, rear
