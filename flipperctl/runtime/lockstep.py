"""The messages of a simulated robot, handed to its node sample by sample.

In: messages and ticks in the order in which they arrive. Out: an answer for each whole sample.
"""

from __future__ import annotations

from typing import Any

from flipperctl.runtime.node import Command, Diagnosis, RobotNode


class Lockstep:
    """Hands the messages of a simulated robot to a node sample by sample, in one order.

    So an episode over topics, whose messages arrive in any order, repeats the one in process.
    """

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        self.begin()

    def begin(self) -> None:
        """Begin an episode, whose messages count from 0."""
        self._waiting: list[tuple[str, Any]] = []
        self._received = 0
        self._tick: tuple[float, float] | None = None
        self._node.reset()

    def take(self, device: str, message: Any) -> tuple[Command | None, Diagnosis] | None:
        """Receive a message of ``belts``, ``joints``, ``imu`` or ``cloud``; see ``tick``."""
        self._received += 1
        self._waiting.append((device, message))
        return None if self._tick is None else self.tick(*self._tick)

    def tick(self, now: float, messages: float) -> tuple[Command | None, Diagnosis] | None:
        """Step once all messages of a sample are there; None: some are still on their way.

        ``now``: its time [s]; ``messages``: how many there were in the episode.
        """
        self._tick = now, messages
        if self._received < messages:
            return None
        node, attitude = self._node, None
        take = {"belts": node.belts, "joints": node.joints, "cloud": node.cloud}
        for device in take:
            for message in [m for name, m in self._waiting if name == device]:
                take[device](now, message)
        for message in [m for name, m in self._waiting if name == "imu"]:
            attitude = node.imu(now, message)
        self._waiting, self._tick = [], None
        return node.step(now, attitude)
