"""Shadow mode on recorded messages: what a policy would have done while someone else drove.

In: a controller in shadow mode, messages with their times. Out: a line of JSON for each decision
and each change of state, and how often each fault came. Nothing is commanded.
"""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from flipperctl.runtime.controller import Answer, FlipperController
from flipperctl.runtime.messages import JointAngles
from flipperctl.runtime.setup import RobotSetup

_TICK = 0.05
"""Longest time between two steps, which a robot's timer keeps without messages too [s]."""
_JUMP = 10.0
"""Longest pause in a recording; a longer one is a jump of its clock [s]."""


class Shadow:
    """Steps a controller by recorded messages, writes its log and counts its faults."""

    def __init__(self, policy: Path, setup: RobotSetup, write: Callable[[str], object]) -> None:
        """``write`` receives each line of the log, without its end.

        Raises:
            MissingExtraError: onnxruntime is missing, or small_gicp for matched scans.
            PolicyError: the file is no exported policy.
        """
        self._controller = FlipperController(policy, setup, log=self._log, shadow=True)
        self._write = write
        self._measured: tuple[float, float] | None = None
        self._begun: float | None = None
        self._last: tuple[float, Answer] | None = None
        self._states: defaultdict[str, float] = defaultdict(float)  # their times [s]
        self._actions: Counter[int] = Counter()
        self._warnings = 0
        self._faults: dict[str, dict[str, Any]] = {}

    def take(self, now: float, messages: Mapping[str, object]) -> None:
        """Receive the messages of one time, and let time pass until then."""
        for between in self._ticks(now):
            self._step(between, {})
        self._step(now, messages)

    def _ticks(self, now: float) -> Iterator[float]:
        if self._last is None or not 0 < now - self._last[0] <= _JUMP:
            return
        then = self._last[0]
        for tick in range(1, math.ceil((now - then) / _TICK - 1e-6)):
            yield then + tick * _TICK

    def _step(self, now: float, messages: Mapping[str, object]) -> None:
        joints = messages.get("joints")
        if isinstance(joints, JointAngles):
            angles = joints.front, joints.rear
            if all(map(math.isfinite, angles)):  # a message of other joints has none
                self._measured = angles
        self._begun = now if self._begun is None else self._begun
        answer = self._controller.step(now, **messages)  # type: ignore[arg-type]  # any content
        elapsed = 0.0
        if self._last is not None:
            elapsed = max(0.0, now - self._last[0])
            self._states[self._last[1].state] += elapsed
        if answer.action is not None:
            self._actions[answer.action] += 1
            self._warnings += answer.warning
        if answer.fault:
            found = self._faults.setdefault(
                answer.fault, {"count": 0, "seconds": 0.0, "reason": answer.reason}
            )
            again = self._last is not None and self._last[1].fault == answer.fault
            found["count"] += not again
            found["seconds"] += elapsed if again else 0.0
        self._last = now, answer

    def _log(self, line: str) -> None:
        """Write a line of the controller, with the angles at which someone else holds the flippers.

        Both are in the signs of the robot.
        """
        self._write(json.dumps({**json.loads(line), "measured": self._measured}))

    def summary(self) -> dict[str, Any]:
        """Return seconds, decisions, warnings, the time in each state and the faults."""
        seconds = 0.0
        if self._last is not None and self._begun is not None:
            seconds = self._last[0] - self._begun
        tells = self._controller.policy.interface.risk is not None
        return {
            "seconds": seconds,
            "decisions": self._actions.total(),
            **({"warnings": self._warnings} if tells else {}),
            "actions": {str(action): count for action, count in sorted(self._actions.items())},
            "states": {state: round(time, 3) for state, time in self._states.items()},
            "faults": {
                name: {**found, "seconds": round(found["seconds"], 3)}
                for name, found in self._faults.items()
            },
        }


def run(
    policy: Path, steps: Iterable[tuple[float, Mapping[str, object]]], setup: RobotSetup
) -> int:
    """Print the log of a policy on messages; return the exit status."""
    shadow = Shadow(policy, setup, lambda line: print(line, flush=True))
    for now, messages in steps:
        shadow.take(now, messages)
    return 0
