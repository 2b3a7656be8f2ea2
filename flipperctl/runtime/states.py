"""When a robot waits, stands by, drives, holds and stops, and how long a command counts.

In: at each step the fault, if there is one, and the speeds of the belts. Out: the state, by one
table; for whoever turns the motors, what the newest command still allows. Pure: no numpy, no clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from flipperctl.runtime.messages import Limits

Angles = tuple[float, ...]
"""Angle of each joint, (J,) [rad]."""
State = Literal["waiting", "standby", "driving", "holding", "stopped", "latched"]
Event = Literal["ready", "parked", "unsure", "fault", "stop", "latch", "acknowledge"]

EVENTS: tuple[Event, ...] = ("ready", "parked", "unsure", "fault", "stop", "latch", "acknowledge")
"""No fault and belts that drive, or that do not; a fault that ended too lately; a fault; one that
stops the belts; one that stops them until an acknowledgement; the acknowledgement."""
_ROWS: dict[State, str] = {
    "waiting": "driving standby waiting waiting stopped stopped waiting",
    "standby": "driving standby standby holding stopped latched standby",
    "driving": "driving standby driving holding stopped latched driving",
    "holding": "driving standby holding holding stopped latched holding",
    "stopped": "driving standby stopped stopped stopped latched waiting",
    "latched": "latched latched latched latched latched latched waiting",
}
TABLE: dict[tuple[State, Event], State] = {
    (state, event): after  # type: ignore[misc]  # of literals
    for state, row in _ROWS.items()
    for event, after in zip(EVENTS, row.split(), strict=True)
}
"""State and event → next state."""
DRIVES = frozenset({"standby", "driving", "holding"})
"""The states in which the belts may run."""
COMMANDS = frozenset({"driving", "holding", "stopped", "latched"})
"""The states in which flippers are commanded, once a decision was made."""
_SUMS = 1e-9  # for times that are sums of periods [s]


@dataclass(frozen=True)
class Fault:
    """Why no decision is made."""

    name: str
    """Its stable name, as ``cloud_age``."""
    reason: str
    """What was found and what is allowed."""
    at_once: bool = False
    """Whether the belts stop without a time of holding."""
    gap: bool = False
    """Whether something is missing, rather than wrong: a stop by it ends by itself."""
    strike: bool = False
    """Whether a second such fault, or a stop, within ``Limits.again`` stops at once."""


class States:
    """The state of a robot."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.state: State = "waiting"
        self.manual = False  # whether an operator drives, as if the robot were parked
        self._speed = math.nan  # of the belts, as on a robot without their encoders [m/s]
        self._driven, self._stands = True, False  # what the last speed says, and what counts
        self._clear()

    def _clear(self) -> None:
        self.event: Event = "fault"
        self.cause: Fault | None = None
        """The last fault, and in ``latched`` the fault of the stop."""
        self.since: float | None = None
        """Since when there have been faults, with no longer pause than ``Limits.recurs`` [s]."""
        self._faulty = -math.inf  # the last time with a fault [s]
        self._faults = 0  # how many make up the present one
        self._name = ""  # of the fault at the last step
        self._struck = -math.inf  # the last time with a strike [s]
        self._changed = -math.inf  # since when the speeds have said so [s]
        self._ran = False  # whether it may have driven

    def belts(self, now: float, speed: float) -> None:
        """Receive a speed of the belts, ahead positive [m/s].

        They stand once they have been slow for ``standby_after``, and drive once they have been
        fast for ``standby_until``. So a single speed, as from slack tracks, moves no flipper of a
        parked robot. If the first speed of all is slow, that counts at once.
        """
        driven = speed >= self._limits.standby_speed
        if math.isnan(self._speed):
            self._stands = not driven
        self._speed = speed
        if driven is not self._driven:
            self._driven, self._changed = driven, now

    @property
    def driven(self) -> bool:
        """Whether the last speed of the belts says that they drive; without one they do not."""
        return self._driven and not math.isnan(self._speed)

    def update(self, now: float, fault: Fault | None) -> State:
        """Return the state by the fault of this time [s]; None: nothing is wrong."""
        if self.state == "stopped" and not self._ran:
            self.acknowledge()  # nothing had moved
        # Belts count as driving or standing once their speeds have said so for a while.
        if self._stands is self._driven:  # the last speeds say otherwise
            wait = self._limits.standby_until if self._driven else self._limits.standby_after
            if now - self._changed >= wait - _SUMS:
                self._stands = not self._driven
        self.event = self._calm(now) if fault is None else self._wrong(now, fault)
        return self._go()

    def acknowledge(self) -> State:
        """Let a robot drive again whose stop lasts until then."""
        self.event = "acknowledge"
        if self._go() == "waiting":
            self._clear()
        return self.state

    def _go(self) -> State:
        self.state = TABLE[self.state, self.event]
        self._ran = self._ran or self.state in DRIVES
        return self.state

    def _calm(self, now: float) -> Event:
        """Return the event without a fault.

        A first short fault is over with its end, recurring ones once none has come for a while, and
        a stop once the robot has stood for ``rest``.
        """
        self._name, limits = "", self._limits
        # Faults belong together until a pause between them.
        calm = now - self._faulty
        if self.state == "waiting":  # what was missing at the start counts no more
            self.since, self._faults, self._faulty = None, 0, -math.inf
        elif self.since is not None and calm >= limits.recurs - _SUMS:
            self.since, self._faults = None, 0

        # A stop ends after a rest, recurring faults after a pause.
        if self.state == "stopped":
            self._struck = max(self._struck, self._faulty)
            wait = limits.rest
        else:
            wait = limits.recurs if self._faults > 1 else 0.0
        if calm < wait - _SUMS:
            return "unsure"
        return "parked" if self._stands or self.manual else "ready"

    def _wrong(self, now: float, fault: Fault) -> Event:
        """Return the event of a fault."""
        # Whether this is another fault, or the last one that goes on
        limits, new = self._limits, fault.name != self._name
        self.cause = self.cause if self.state == "latched" else fault
        if self.since is None or now - self._faulty > limits.recurs:
            self.since, self._faults = now, 0
        self._faults += not self._name
        self._faulty, self._name = now, fault.name

        # A fault stops the belts if it must at once, if it lasts, or if it strikes again.
        again = now - self._struck < limits.again
        lasts = self.state == "holding" and now - self.since >= limits.stop_after - _SUMS
        struck = new and fault.strike and again
        if fault.strike and new:
            self._struck = now
        if not (fault.at_once or lasts or struck):
            return "fault"
        self._struck = now
        return "stop" if fault.gap and not again else "latch"

    def reason(self) -> str:
        """Return a sentence with the belts' speed, for an answer in standby."""
        if self.manual:
            return "an operator drives; the policy decides nothing meanwhile"
        return (
            f"the belts drive at {self._speed:.2f} m/s; the policy decides nothing until that is "
            f"{self._limits.standby_speed:g} m/s or more"
        )


class CommandWatch:
    """What the newest command still allows, for whoever drives the motors.

    Ask it at each period of the motors. Without a command that is in force the belts stand, and the
    flippers are held where they are.
    """

    def __init__(self) -> None:
        self._stamp = self._until = -math.inf
        self._drive = False
        self._angles: Angles | None = None

    def take(
        self, now: float, time: float, valid_for: float, drive: bool, angles: Angles | None
    ) -> None:
        """Receive a command that was sent at ``time`` and counts for ``valid_for`` [s].

        ``angles``: the targets or the setpoints of an answer [rad]. A command without a time, or
        older than the last one, is ignored. One from ahead of the clock ``now`` counts from now on.
        """
        if not math.isfinite(time) or time < self._stamp <= now:
            return
        self._stamp = min(time, now)
        self._until = self._stamp + valid_for
        self._drive, self._angles = drive, angles

    def drives(self, now: float) -> bool:
        """Return whether the belts may run."""
        return self._drive and now < self._until

    def angles(self, now: float) -> Angles | None:
        """Return where the flippers are to be turned [rad]; None: send them nothing."""
        return self._angles if now < self._until else None
