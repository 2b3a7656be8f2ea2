"""Finds wrong signs on a robot: the builder moves a part, and the test says how it was measured.

In: messages of the robot's devices while the builder follows the instructions. Out: a verdict for
each sign.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.core.lidar.body import mounting
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Scan
from flipperctl.errors import PolicyError, RequestError
from flipperctl.runtime.intake import Intake
from flipperctl.runtime.messages import KINDS
from flipperctl.runtime.setup import Limits, RobotSetup

_PATIENCE = 60.0
"""Time without the motion that was asked for after which a part counts as not measured [s]."""
_NEAR = 0.3, 1.0, 0.3
"""A board is looked for between the first two distances ahead or behind, and no lower below the
LiDAR than the third [m]."""
_FEWEST = 10
"""Points that make up a board [-]."""


@dataclass(frozen=True)
class _Part:
    """A motion that the builder makes, and what must grow by it."""

    sign: str
    """The entry of ``Signs`` that it tests."""
    device: str
    """The device that measures it."""
    instruction: str
    threshold: float
    """Change that counts as the motion."""
    unit: str


PARTS = (
    _Part("front", "joints", "Raise the front flippers by 15° or more.", 0.2, "rad"),
    _Part("rear", "joints", "Raise the rear flippers by 15° or more.", 0.2, "rad"),
    _Part("pitch", "attitude", "Lift the nose of the robot by 5° or more.", 0.08, "rad"),
    _Part(
        "yaw", "attitude", "Lower it, and turn the robot to the left by 20° or more.", 0.3, "rad"
    ),
    _Part("x", "odometry", "Drive ahead by 0.2 m or more.", 0.15, "m"),
    _Part("x", "cloud", "Stand still; hold a board upright 0.5 m ahead of the LiDAR.", 0.15, "m"),
)
"""The motions in their order; one whose device never reports is told as not measured."""


@dataclass(frozen=True)
class Verdict:
    """What a motion showed."""

    sign: str
    """The entry of ``Signs``."""
    device: str
    """The device that measured it."""
    right: bool | None
    """Whether the sign is right; None: the motion was not measured."""
    text: str
    """The finding in words."""


class SelfTest:
    """Takes messages, tells the builder what to do next, and collects the verdicts."""

    def __init__(self, setup: RobotSetup) -> None:
        """``setup``: the signs, frames and the mount that are tested."""
        self._setup = setup
        self._intake = Intake(setup, Limits())
        self._rotation, self._place = mounting(setup.mount.axis), setup.mount
        self._values: dict[str, float] = {"yaw": 0.0, "odometry": 0.0}
        self._times: dict[str, float] = {}
        self._parts = iter(PARTS)
        self.part: _Part | None = next(self._parts)
        self.verdicts: list[Verdict] = []
        self._base: dict[str, float] = {}
        self._begun: float | None = None

    @property
    def wrong(self) -> tuple[str, ...]:
        """The signs that were found wrong, each once."""
        return tuple(dict.fromkeys(v.sign for v in self.verdicts if v.right is False))

    @property
    def passed(self) -> bool:
        """Whether every motion was measured, each with the right sign."""
        return all(v.right for v in self.verdicts)

    def step(self, now: float, **messages: object) -> str:
        """Take in messages as ``FlipperController.step`` does; return new lines, mostly none."""
        lines = []
        if self._begun is None:
            self._begun = now
            lines.append(self._instruction())
        for device, time, message in self._intake.receive(now, **messages):
            self._measure(device, time, message)
        verdict = self._verdict(now)
        if verdict is not None:
            self.verdicts.append(verdict)
            lines.append(f"  {verdict.text}")
            self.part, self._begun = next(self._parts, None), now
            self._base = {}
            lines.append(self._instruction() if self.part else self._summary())
        return "\n".join(lines)

    def _instruction(self) -> str:
        assert self.part is not None
        return f"{PARTS.index(self.part) + 1} of {len(PARTS)}: {self.part.instruction}"

    def _summary(self) -> str:
        silent = [v.device for v in self.verdicts if v.right is None]
        if self.wrong:
            return f"Wrong signs: {', '.join(self.wrong)}."
        return (
            f"No sign is wrong; not measured: {', '.join(silent)}." if silent else "All is right."
        )

    def _measure(self, device: str, time: float, message: object) -> None:
        """Update what is watched: angles, the heading and the way since the start."""
        elapsed = time - self._times.get(device, time)
        self._times[device] = time
        if isinstance(message, Joints):
            self._values |= {"front": message.front, "rear": message.rear}
        elif isinstance(message, Inertial):
            self._values["pitch"] = message.pitch
            self._values["yaw"] += message.yaw_rate * elapsed
        elif isinstance(message, Belts):
            self._values["odometry"] += message.speed * elapsed
        elif isinstance(message, Scan):
            self._look(message)

    def _look(self, scan: Scan) -> None:
        """Count the points ahead and behind between which a board may appear."""
        mount = self._place
        points = np.asarray(scan.points) @ self._rotation.T + (mount.x, 0.0, mount.z)
        near, far, low = _NEAR
        beside = (np.abs(points[:, 1]) < near) & (points[:, 2] > mount.z - low)
        self._values["ahead"] = float(np.sum(beside & _between(points[:, 0], near, far)))
        self._values["behind"] = float(np.sum(beside & _between(-points[:, 0], near, far)))

    def _verdict(self, now: float) -> Verdict | None:
        """Return what the present motion showed, once it was made."""
        part = self.part
        if part is None or self._begun is None:
            return None
        grown = self._grown(part)
        if grown is None or abs(grown) < part.threshold:
            if now - self._begun < _PATIENCE:
                return None
            text = f"{part.sign}: {part.device} showed no such motion in {_PATIENCE:g} s"
            return Verdict(part.sign, part.device, None, text)
        if grown > 0:
            text = f"{part.sign}: right ({part.device}, {grown:+.2f} {part.unit})"
            return Verdict(part.sign, part.device, True, text)
        now_set = getattr(self._setup.signs, part.sign)
        text = (
            f"{part.sign}: WRONG: {part.device} changed by {grown:+.2f} {part.unit}, which must "
            f"grow; set signs.{part.sign} to {-now_set}"
        )
        return Verdict(part.sign, part.device, False, text)

    def _grown(self, part: _Part) -> float | None:
        """Return by how much what the motion must raise has grown since its beginning."""
        if part.device == "cloud":
            return self._board_side()
        name = "odometry" if part.device == "odometry" else part.sign
        if part.device not in self._times:
            return None
        base = self._base.setdefault(name, self._values[name])
        return self._values[name] - base

    def _board_side(self) -> float | None:
        """Return 1 if a board appeared ahead, -1 if behind, 0 if nowhere."""
        if "cloud" not in self._times:
            return None
        more = [
            self._values[side] - self._base.setdefault(side, self._values[side])
            for side in ("ahead", "behind")
        ]
        if max(more) < _FEWEST:
            return 0.0
        return 1.0 if more[0] > more[1] else -1.0


def _between(values: Any, low: float, high: float) -> Any:
    return (values >= low) & (values <= high)


_NO_MESSAGE = (
    *(ValueError, TypeError, KeyError, AttributeError),
    *(RecursionError, OverflowError),
)
"""What a line raises that is no message."""


def read_lines(lines: Iterable[str], where: str) -> Iterator[tuple[float, dict[str, object]]]:
    """Yield time and messages of lines of JSON, as ``{"time": 1.2, "joints": {"front": 0, …}}``.

    A message without a time has that of its line.

    Raises:
        PolicyError: a line is something else; the text names it.
    """
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            time = float(entry.pop("time"))
            messages = {
                name: KINDS[name](**{"time": time, **values}) for name, values in entry.items()
            }
        except _NO_MESSAGE as error:
            known = "; ".join(
                f"{name}: {', '.join(f.name for f in fields(kind))}" for name, kind in KINDS.items()
            )
            raise PolicyError(
                f"{where}, line {number}: {line.strip()[:60]!r} is no message; a JSON object "
                f"with a time and some of these is allowed: {known}"
            ) from error
        if not math.isfinite(time):
            raise PolicyError(
                f"{where}, line {number}: the time is {time}; a finite one is allowed"
            )
        yield time, messages


def opened(file: str) -> tuple[Iterable[str], str]:
    """Return the lines of a file, or of the standard input for ``-``, and its name in errors."""
    return (sys.stdin, "the input") if file == "-" else (_lines(file), file)


def _lines(file: str) -> Iterator[str]:
    """Yield the lines of a file; an error of the file names it, one of its reader passes."""
    try:
        with Path(file).open(encoding="utf-8") as lines:
            yield from lines
    except (OSError, ValueError) as error:
        raise RequestError(f"{file} cannot be read: {error}") from error


def run(lines: Iterable[str], where: str, setup: RobotSetup) -> SelfTest:
    """Test the messages of ``lines``, and print instructions and verdicts."""
    test, now = SelfTest(setup), 0.0
    for now, messages in read_lines(lines, where):
        told = test.step(now, **messages)
        if told:
            print(told, flush=True)
        if test.part is None:
            break
    while test.part is not None:  # the input ended: nothing more will move
        now += _PATIENCE
        print(test.step(now), flush=True)
    return test
