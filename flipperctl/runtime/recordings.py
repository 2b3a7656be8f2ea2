"""What the messages of a robot's devices tell: wrong signs, and what a policy would have done.

In: messages with their times, from lines of JSON or a bag. The self-test asks the builder to move a
part and says how that was measured: a verdict for each sign. Shadow mode steps a controller while
someone else drives: a line of JSON for each decision and each change of state, and how often each
fault came. Nothing is commanded.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flipperctl.core.lidar.body import Mount, mounting
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Scan
from flipperctl.core.targets import closest
from flipperctl.errors import PolicyError, RequestError
from flipperctl.runtime.controller import Answer, FlipperController
from flipperctl.runtime.devices import Devices
from flipperctl.runtime.intake import Intake
from flipperctl.runtime.messages import CONVENTIONS, KINDS, JointAngles, Limits, RobotSetup

_NO_MESSAGE = (
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    RecursionError,
    OverflowError,
)
"""What a line raises that is no message."""


def read_lines(
    lines: Iterable[str], where: str, devices: Devices | None = None
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield time and messages of lines of JSON, as ``{"time": 1.2, "joints": {"front": 0, …}}``.

    A message without a time has its line's. With ``devices``, numbers are in the robot's units, and
    ``joints`` may have the angle of each joint by its name, as ``{"fl": 12.0, "fr": -12.0, …}``.
    """
    newest = None if devices is None else devices.newest_joints()
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            time = float(entry.pop("time"))
            messages: dict[str, Any] = {}
            for name, values in entry.items():
                named = {"time": time, **values}
                if name == "joints" and newest is not None and not {"front", "rear"} & {*named}:
                    angles = newest.take(float(named.pop("time")), named.keys(), named.values())
                    messages |= {} if angles is None else {name: angles}
                    continue
                message = KINDS[name](**named)
                messages[name] = message if devices is None else devices.measured(message)
        except _NO_MESSAGE as error:
            # The error shows what a message may have.
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


_PATIENCE = 60.0
"""Time without the motion that was asked for after which a part counts as not measured [s]."""
_NEAR = 0.3, 1.0, 0.3
"""A board is looked for between the first two distances ahead or behind, and no lower below the
LiDAR than the third [m]."""


class _Part(NamedTuple):
    """A motion that the builder makes, and what must grow by it."""

    sign: str
    """The entry of ``Signs`` that it tests."""
    device: str
    instruction: str
    threshold: float
    """Change that counts as the motion."""
    unit: str
    advice: str
    """What mends a wrong sign of a robot with a file of devices."""


_JOINTS = "change joints.signs, or the - before the names of joints."
_IMU = "turn the Imu as REP-103 does, or mend the place of its frame in tf"
_PARTS = (
    _Part(
        "front", "joints", "Raise the front flippers by 15° or more.", 0.2, "rad", f"{_JOINTS}front"
    ),
    _Part(
        "rear", "joints", "Raise the rear flippers by 15° or more.", 0.2, "rad", f"{_JOINTS}rear"
    ),
    _Part("pitch", "attitude", "Lift the nose of the robot by 5° or more.", 0.08, "rad", _IMU),
    _Part(
        *("yaw", "attitude", "Lower it, and turn the robot to the left by 20° or more."),
        *(0.3, "rad", _IMU),
    ),
    _Part(
        *("x", "odometry", "Drive ahead by 0.2 m or more.", 0.15, "m"),
        "change the sign of belts.scale",
    ),
    _Part(
        *("x", "cloud", "Stand still; hold a board upright 0.5 m ahead of the LiDAR."),
        *(10, "points", "mend lidar.axis, or the place of the clouds' frame in tf"),
    ),
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

    def __init__(self, setup: RobotSetup, *, of_devices: bool = False) -> None:
        """``setup``: the signs, frames and the mount that are tested.

        ``of_devices``: whether it is that of a file of devices, whose keys the advice names.
        """
        self._setup, self._of_devices = setup, of_devices
        self._intake = Intake(setup, Limits())
        self._rotation = mounting(setup.mount.axis)
        self._values: dict[tuple[str, str], float] = {}  # sign and device → what is watched
        self._times: dict[str, float] = {}
        self._base: float | None = None  # the value when the motion was asked for
        self._begun: float | None = None
        self.verdicts: list[Verdict] = []
        self.refused: dict[str, str] = {}
        """Device → the first value of it that no robot has, as by a wrong unit."""

    @property
    def over(self) -> bool:
        """Whether each motion has its verdict."""
        return len(self.verdicts) == len(_PARTS)

    @property
    def wrong(self) -> tuple[str, ...]:
        """The signs that were found wrong, each once."""
        return tuple(dict.fromkeys(v.sign for v in self.verdicts if v.right is False))

    @property
    def passed(self) -> bool:
        """Whether every motion was measured, each with the right sign and in its unit."""
        return all(v.right for v in self.verdicts) and not self.refused

    def step(self, now: float, **messages: object) -> str:
        """Take in messages as ``FlipperController.step`` does; return new lines, mostly none."""
        lines = []
        if self._begun is None:
            self._begun = now
            lines.append(self._next())
        for device, time, message in self._intake.receive(now, **messages):
            self._measure(device, time, message)
        for device in messages:
            fault = self._intake.refused(device)
            if fault is not None and fault.name.endswith("_value"):
                self.refused.setdefault(device, fault.reason)
        verdict = None if self.over else self._verdict(now - self._begun)
        if verdict is not None:
            self.verdicts.append(verdict)
            self._begun, self._base = now, None
            lines += [f"  {verdict.text}", self._next()]
        return "\n".join(lines)

    def _next(self) -> str:
        """Return the next instruction, or at the end the result."""
        if not self.over:
            done = len(self.verdicts)
            return f"{done + 1} of {len(_PARTS)}: {_PARTS[done].instruction}"
        if self.wrong:
            return f"Wrong signs: {', '.join(self.wrong)}."
        if self.refused:
            return f"Refused, as of a wrong unit: {'; '.join(self.refused.values())}."
        silent = ", ".join(v.device for v in self.verdicts if v.right is None)
        return f"No sign is wrong; not measured: {silent}." if silent else "All is right."

    def _measure(self, device: str, time: float, message: object) -> None:
        """Update what is watched: angles, the heading, the way and the points of a board."""
        elapsed = time - self._times.get(device, time)
        self._times[device] = time
        values = self._values
        # Each sign is watched in the quantity that its motion must make grow.
        match message:
            case Joints():
                values["front", device], values["rear", device] = message.front, message.rear
                if (most := max(abs(message.front), abs(message.rear))) > math.pi:
                    text = f"{device}: an angle of {most:.2f} rad; at most π is allowed"
                    self.refused.setdefault(device, text)
            case Inertial():
                values["pitch", device] = message.pitch
                values["yaw", device] = (
                    values.get(("yaw", device), 0.0) + message.yaw_rate * elapsed
                )
            case Belts():
                values["x", device] = values.get(("x", device), 0.0) + message.speed * elapsed
            case Scan():
                mount, (near, far, low) = self._setup.mount, _NEAR
                points = np.asarray(message.points) @ self._rotation.T + (mount.x, 0.0, mount.z)
                x, y, z = points.T
                close = (np.abs(y) < near) & (z > mount.z - low)
                board = close & (np.abs(x) >= near) & (np.abs(x) <= far)
                values["x", device] = float(np.sign(x[board]).sum())  # ahead less behind

    def _verdict(self, elapsed: float) -> Verdict | None:
        """Return what the present motion showed, once it was made or nobody makes it."""
        part = _PARTS[len(self.verdicts)]
        sign, device = part.sign, part.device
        # The motion counts from the value at which it was asked for.
        value = self._values.get((sign, device))
        if self._base is None:
            self._base = value
        grown = 0.0 if value is None or self._base is None else value - self._base
        if abs(grown) < part.threshold:
            if elapsed < _PATIENCE:
                return None
            text = f"{sign}: {device} showed no such motion in {_PATIENCE:g} s"
            refused = self._intake.refused(device)
            text += "" if refused is None else f": {refused.reason}"
            return Verdict(sign, device, None, text)
        if grown > 0:
            text = f"{sign}: ok ({device}, {grown:+.2f} {part.unit})"
            return Verdict(sign, device, True, text)
        advice = f"set signs.{sign} to {-getattr(self._setup.signs, sign)}"
        text = (
            f"{sign}: WRONG: {device} changed by {grown:+.2f} {part.unit}, which must "
            f"grow; {part.advice if self._of_devices else advice}"
        )
        return Verdict(sign, device, False, text)


def setup_by(devices: Devices | None, signs: str) -> RobotSetup:
    """Return the setup of a robot's devices, or of a convention of signs without them.

    Clouds are in the frame of their mount.
    """
    if devices is None:
        return RobotSetup(signs=CONVENTIONS[signs])
    at, frame = devices.lidar, "lidar" if devices.mount is not None else devices.frames.base
    mount = devices.mount or Mount(0.0, 0.0, math.pi / 2, at.near, at.margin)
    return replace(devices.setup(mount), cloud_frame=frame)


def self_test(
    lines: Iterable[str], where: str, setup: RobotSetup, devices: Devices | None = None
) -> SelfTest:
    """Test the messages of ``lines``, and print instructions and verdicts; see ``read_lines``."""
    test, now = SelfTest(setup, of_devices=devices is not None), 0.0
    for now, messages in read_lines(lines, where, devices):
        text = test.step(now, **messages)
        if text:
            print(text, flush=True)
        if test.over:
            break
    while not test.over:  # the input ended: nothing more will move
        now += _PATIENCE
        print(test.step(now), flush=True)
    return test


_TICK = 0.05
"""Longest time between two steps, which a robot's timer keeps without messages too [s]."""
_JUMP = 10.0
"""Longest pause in a recording; a longer one is a jump of its clock [s]."""


class Shadow:
    """Steps a controller by recorded messages, writes its log and counts its faults."""

    def __init__(
        self,
        policy: Path,
        setup: RobotSetup,
        write: Callable[[str], object],
        limits: Limits | None = None,
    ) -> None:
        """``write`` receives each line of the log, without its end."""
        self._controller = FlipperController(policy, setup, limits, self._log, shadow=True)
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
        if self._last is not None and 0 < now - (then := self._last[0]) <= _JUMP:
            # A robot's timer steps without messages, too.
            for tick in range(1, math.ceil((now - then) / _TICK - 1e-6)):
                self._step(then + tick * _TICK, {})
        self._step(now, messages)

    def _step(self, now: float, messages: Mapping[str, object]) -> None:
        # The log has the measured angles beside the targets.
        joints = messages.get("joints")
        if isinstance(joints, JointAngles):
            angles = joints.front, joints.rear
            if all(map(math.isfinite, angles)):  # a message of other joints has none
                self._measured = angles
        answer = self._controller.step(now, **messages)  # type: ignore[arg-type]  # any content
        elapsed, before = 0.0, ""
        if self._last is None:
            self._begun = now
        else:
            elapsed, before = max(0.0, now - self._last[0]), self._last[1].fault
            self._states[self._last[1].state] += elapsed
        if answer.action is not None:
            taken = answer.action
            self._actions[closest(taken)] += 1
            self._warnings += answer.warning
        if answer.fault:
            entry = self._faults.setdefault(
                answer.fault, {"count": 0, "seconds": 0.0, "reason": answer.reason}
            )
            again = before == answer.fault
            entry["count"] += not again
            entry["seconds"] += elapsed if again else 0.0
        self._last = now, answer

    def _log(self, line: str) -> None:
        """Write a line of the controller with the measured angles, in the robot's signs."""
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
                name: {**entry, "seconds": round(entry["seconds"], 3)}
                for name, entry in self._faults.items()
            },
        }
