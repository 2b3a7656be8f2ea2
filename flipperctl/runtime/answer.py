"""What a controller answers to a step, and the line of its log about it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from numbers import Real
from typing import Literal

Pair = tuple[float, float]
State = Literal["waiting", "standby", "driving", "holding", "stopped"]


@dataclass(frozen=True)
class Answer:
    """What the flippers and the belts shall do until the next step."""

    targets: Pair | None
    """Angles to turn the front and the rear flippers to, in the robot's signs [rad].

    None as long as no angle was measured: then leave the flippers as they are.
    """
    setpoints: Pair | None
    """Where the flippers shall be now on their way there, at the speed of the training [rad]."""
    drive: bool
    """Whether the belts may run."""
    state: State
    """``waiting`` for the first inputs, ``driving``, ``holding`` the flippers, or ``stopped``.

    In ``standby`` the flippers are held too: nothing is wrong, and the belts do not drive ahead.
    """
    fault: str = ""
    """Stable name of the fault, as ``cloud_age``; empty without one."""
    reason: str = ""
    """What was found and what is allowed, of a fault or in standby; otherwise empty."""
    action: int | None = None
    """The action, if this step decided; a row of ``interface.actions``."""
    risk: float | None = None
    """Probability of a failure soon, at the last decision; None before one, while the flippers are
    not driven, and for a file without a risk."""
    warning: bool = False
    """Whether the risk is the file's threshold or more."""


def log_line(now: float, answer: Answer, *, risk: bool) -> str:
    """Return the answer as a line of JSON. ``risk``: whether the file's policy tells one."""
    told = asdict(answer)
    if not risk:  # the lines of files without a risk stay
        del told["risk"], told["warning"]
    return json.dumps({"time": short(now) if (time := finite(now)) is None else time, **told})


def finite(number: object) -> float | None:
    """Return a finite real number, of Python or numpy; None for anything else."""
    if isinstance(number, bool) or not isinstance(number, Real):
        return None
    try:
        found = float(number)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def short(value: object) -> str:
    """Return a value as text of at most 40 characters."""
    try:
        return str(value)[:40]
    except ValueError:  # Python writes no integer of more than 4300 digits
        return type(value).__name__
