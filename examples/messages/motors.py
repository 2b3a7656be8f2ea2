"""Motors that obey a controller, and stop when no command comes: the last part of a robot's driver.

    my_controller | python examples/messages/motors.py

It runs in a process of its own, so that it outlives the controller's. Each line of its input is an
answer of ``FlipperController`` as JSON: ``time`` and ``valid_for``, ``drive``, ``setpoints``.
Replace ``print`` by what moves your motors; the times are those of ``time.monotonic``.
"""

import json
import select
import sys
import time
from collections.abc import Callable

from flipperctl.runtime import CommandWatch

PERIOD = 0.02
"""Time between two commands to the motors [s]."""
SPEED = 0.2
"""Speed of the belts, which the operator chooses [m/s]."""


class Motors:
    """Passes on what the newest command allows."""

    def __init__(self, belts: Callable[[float], object], flippers: Callable[..., object]) -> None:
        """``belts`` takes a speed [m/s]; ``flippers`` two angles [rad], or None: stop turning."""
        self._watch, self._belts, self._flippers = CommandWatch(), belts, flippers

    def receive(self, now: float, line: str) -> None:
        """Take a command, a line of JSON."""
        command = json.loads(line)
        names = "time", "valid_for", "drive", "setpoints"
        self._watch.take(now, *(command[name] for name in names))

    def tick(self, now: float) -> None:
        """Command the motors; call it in each period, whether or not something has come."""
        self._belts(SPEED if self._watch.drives(now) else 0.0)
        self._flippers(self._watch.angles(now))


if __name__ == "__main__":
    motors = Motors(lambda speed: print("belts", speed), lambda angles: print("flippers", angles))
    connected = True
    while True:
        if connected and select.select([sys.stdin], [], [], PERIOD)[0]:
            line = sys.stdin.readline()
            connected = bool(line)
            if line:
                motors.receive(time.monotonic(), line)
        else:
            time.sleep(0 if connected else PERIOD)
        motors.tick(time.monotonic())
