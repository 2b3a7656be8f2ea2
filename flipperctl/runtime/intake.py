"""Checks what a driver hands over, before anything uses it.

In: messages of any content, with their times. Out: messages of ``flipperctl.core.lidar`` in
flipperctl's signs, and the fault that keeps a decision from being made.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.crosschecks import Tilts, exceeds
from flipperctl.core.lidar.messages import (
    Belts,
    Inertial,
    Joints,
    Scan,
    checked_scan,
    real,
    short,
)
from flipperctl.runtime.messages import (
    ABSENT,
    KINDS,
    Attitude,
    Cloud,
    JointAngles,
    Limits,
    RobotSetup,
)
from flipperctl.runtime.states import Fault

Accepted = Scan | Inertial | Joints | Belts
_FEWEST_POINTS = 20
"""Points without which a cloud tells nothing [-]."""
_LONGEST_TURN = 1.0
"""Largest age of a point at the time of its cloud; points of other ages are left out [s]."""
_STEEPEST = 1e-3
"""Least square of the cosine of the tilt with which a turn is told [-]."""
_LARGEST_ANGLE = 1e4
"""Largest angle of a joint that is a number at all [rad]."""
_FASTEST_TURN, _FASTEST = 20.0, 5.0
"""Largest plausible yaw rate [rad/s] and belt speed [m/s]; beyond it the unit is wrong."""


_JITTER = 10
"""Times that an attitude turned back, with no repeat between, after which it never repeats [-]."""


class _RefusedError(Exception):
    """A message that does not fit; holds a ``Fault``."""


class Intake:
    """The newest accepted message of each device, and the newest refusal."""

    def __init__(
        self,
        setup: RobotSetup,
        limits: Limits,
        cloud_needs: Collection[str] = ("joints", "attitude"),
        since: float = -math.inf,
        joints: int = 2,
    ) -> None:
        """``cloud_needs``: devices that tell the posture with which a cloud enters the map.

        ``since``: messages stamped before are skipped [s]. ``joints``: J; of 4, a message must have
        the angle of each.
        """
        self._setup, self._limits, self._cloud_needs = setup, limits, cloud_needs
        self.since, self._joints = since, joints
        self._times: dict[str, float] = {}
        self._refused: dict[str, Fault] = {}
        self._tilts = Tilts()
        self._contradicted: Fault | None = None  # until all begins anew
        self._contents: dict[str, NDArray[np.float64]] = {}  # the last ones that may not repeat
        self._repeats: set[str] = set()
        self._turn, self._jitter = np.zeros(2), 0  # the last change of an attitude; see _JITTER
        self._speed = math.inf  # of the belts, as long as it is unknown [m/s]
        self.joints: Joints | None = None
        self.sides: list[list[float]] = []
        """Measured angles of each joint, of a pair those of its sides or their mean [rad]."""
        self.inertial: Inertial | None = None

    @property
    def known(self) -> Collection[str]:
        """The devices with an accepted message."""
        return self._times.keys()

    def refused(self, device: str) -> Fault | None:
        """Return why the latest message of a device was refused; None if it was accepted."""
        return self._refused.get(device)

    def receive(self, now: float, **messages: object) -> Iterator[tuple[str, float, Accepted]]:
        """Yield device, time and content of each message that is accepted; None is ignored.

        A message that is no newer than the last one of its device is skipped, so that a driver may
        hand over the same one again. One that tells nothing new makes its device no younger, and
        no such cloud is yielded.
        """
        for device, message in messages.items():
            if message is None:
                continue
            # A refusal stays until a message of the device is accepted.
            try:
                content = self._checked(device, message, now)
            except _RefusedError as error:
                self._refused[device] = error.args[0]
                continue
            if content is None:
                continue
            time, accepted = content

            # A repeated message leaves its device as old as it was; a repeated cloud would count
            # twice.
            self._refused.pop(device, None)
            if self._is_repeated(device, accepted):
                if isinstance(accepted, Scan):
                    continue
            else:
                self._times[device] = time
            if isinstance(accepted, Belts):
                self._speed = abs(accepted.speed)
            elif isinstance(accepted, Joints):
                self.joints = accepted
            elif isinstance(accepted, Inertial):
                self.inertial = accepted
            yield device, time, accepted

    def _is_repeated(self, device: str, message: Accepted) -> bool:
        """Return whether a message tells nothing new: it repeats though the belts drive.

        It does so until another one comes, also once the robot stands because of that. An attitude
        must have jittered before, since a simulator without noise repeats it on level ground.
        """
        # Encoders may repeat, as on a robot that stands.
        if isinstance(message, Scan):
            content = np.asarray(message.points)
        elif isinstance(message, Inertial):
            content = np.array([message.roll, message.pitch])
        else:
            return False

        # An attitude may repeat until it was seen to jitter.
        before, self._contents[device] = self._contents.get(device), content
        repeats = before is not None and np.array_equal(before, content)
        if isinstance(message, Inertial) and before is not None:
            turn, self._turn = self._turn, content - before
            if self._jitter < _JITTER:
                self._jitter = 0 if repeats else self._jitter + bool((turn * self._turn < 0).any())
            if self._jitter < _JITTER:
                return False

        # Repeats count while the belts drive, until another content comes.
        if not repeats:
            self._repeats.discard(device)
        elif self._speed >= self._limits.standby_speed:
            self._repeats.add(device)
        return device in self._repeats

    def fault(self, now: float) -> Fault | None:
        """Return why a decision cannot be made ``now``, or None."""
        # The first device in this order that is missing or old
        ages = self._limits.ages
        for device in ("joints", "attitude", "cloud", "odometry"):
            limit, time = getattr(ages, device), self._times.get(device)
            if time is None and device == "odometry" and device not in self._refused:
                continue  # a robot without encoders of its belts
            if time is not None and now - time <= limit:
                continue
            if device in self._refused:
                return self._refused[device]
            if time is None:
                return Fault(f"{device}_missing", f"no {device} was received yet", gap=True)
            text = f"{device} is {now - time:.2f} s old; at most {limit:g} s is allowed"
            text += ": all its numbers repeat" if device in self._repeats else ""
            return Fault(f"{device}_age", text, gap=True)
        return self._joints_fault() or self._tilt_fault()

    def _joints_fault(self) -> Fault | None:
        """Return what is wrong with angles that count, so that their motion is compared first."""
        largest = max((abs(angle) for pair in self.sides for angle in pair), default=0.0)
        if largest > math.pi:
            text = f"joints have an angle of {largest:.3g} rad; at most {math.pi:.3g} is allowed"
            return Fault("joints_value", text)
        apart = max((max(pair) - min(pair) for pair in self.sides), default=0.0)
        text = exceeds("joints_pair", apart)
        return Fault("joints_pair", text) if text else None

    def _tilt_fault(self) -> Fault | None:
        tilted = self.inertial
        if tilted is not None and max(abs(tilted.roll), abs(tilted.pitch)) > self._limits.tilt:
            return Fault(
                "tilt",
                f"roll {tilted.roll:+.2f} rad, pitch {tilted.pitch:+.2f} rad; "
                f"±{self._limits.tilt:.2f} rad is allowed",
                at_once=True,
            )
        return None

    def _checked(self, device: str, message: Any, now: float) -> tuple[float, Accepted] | None:
        # Kind, time and order, before any content
        kind = KINDS[device]
        if not isinstance(message, kind):
            raise _refusal(device, "kind", f"is {type(message).__name__}", kind.__name__)
        time = _number(device, "time", message.time, math.inf)
        if time > now + self._limits.ahead:
            raise _refusal(
                device,
                "stamp",
                f"is stamped {time - now:.3f} s ahead of the clock",
                f"{self._limits.ahead:g} s ahead",
            )
        if time <= self._times.get(device, -math.inf) or time < self.since:
            return None
        if isinstance(message, Cloud):
            self._check_posture(time)
            return time, self._scan(message)
        if isinstance(message, Attitude):
            return time, self._attitude(time, message)

        # Angles and speeds in flipperctl's signs
        signs = self._setup.signs
        if isinstance(message, JointAngles):
            factors = signs.front, signs.rear
            means = [
                _number(device, n, getattr(message, n), _LARGEST_ANGLE) for n in ("front", "rear")
            ]
            offsets = [[0.0], [0.0]] if message.offsets is None else _offsets(message.offsets)
            pairs = zip(factors, means, offsets, strict=True)
            sides = [[s * (mean + off) for off in pair] for s, mean, pair in pairs]
            front, rear = (s * a for s, a in zip(factors, means, strict=True))
            if self._joints == len(sides):
                self.sides = sides
                return time, Joints(front, rear)
            # Each joint has a motion of its own.
            each = [angle for pair in sides for angle in pair]
            if len(each) != self._joints:
                raise _refusal(device, "value", "has angles of pairs alone", "one of each flipper")
            self.sides = [[angle] for angle in each]
            return time, Joints(front, rear, tuple(each))
        return time, Belts(signs.x * _number(device, "speed", message.speed, _FASTEST))

    def _check_posture(self, time: float) -> None:
        """Refuse a cloud whose points would enter the map with another posture than the robot's."""
        for device in self._cloud_needs:
            limit, known = getattr(self._limits.ages, device), self._times.get(device)
            late = known is None or time - known > limit
            if late and device in self._refused:  # the true reason
                raise _RefusedError(self._refused[device])
            if known is None:
                problem = f"came before any {device}"
                raise _refusal("cloud", "posture", problem, "one before it", gap=True)
            if late:
                problem = f"is {time - known:.2f} s newer than {device}"
                raise _refusal("cloud", "posture", problem, f"at most {limit:g} s", gap=True)

    def _scan(self, cloud: Cloud) -> Scan:
        _check_frame("cloud", cloud.frame, self._setup.cloud_frame)
        try:
            ages = None if cloud.ages is None else np.asarray(cloud.ages, dtype=np.float64)
            scan = checked_scan(Scan(np.asarray(cloud.points, dtype=np.float64), ages))
        except (TypeError, ValueError, OverflowError) as error:
            raise _RefusedError(Fault("cloud_shape", f"cloud: {error}")) from error

        # Points that returned, and that belong to this turn
        usable, aged = (scan.points != 0).any(axis=1), ""  # 0 of rays without return
        if scan.ages is not None:
            usable &= (scan.ages >= 0) & (scan.ages <= _LONGEST_TURN)
            aged = f" and measured up to {_LONGEST_TURN:g} s before"
        if (count := int(usable.sum())) < _FEWEST_POINTS:
            text = f"has {count} points that are finite, nearer than 1 km, not 0{aged}"
            raise _refusal("cloud", "points", text, f"{_FEWEST_POINTS} or more")
        scan = scan.take(np.flatnonzero(usable))
        if self._setup.signs.x < 0:  # a turn by π about z keeps the frame right-handed
            return Scan(scan.points * (-1.0, -1.0, 1.0), scan.ages)
        return scan

    def _attitude(self, time: float, message: Attitude) -> Inertial:
        _check_frame("attitude", message.frame, self._setup.attitude_frame)
        if all(isinstance(v, float) and math.isnan(v) for v in (message.roll, message.pitch)):
            text = f"attitude has no orientation, or one that is marked as none; {ABSENT}"
            raise _RefusedError(Fault("attitude_value", text))
        roll = _number("attitude", "roll", message.roll, math.pi)
        pitch = _number("attitude", "pitch", message.pitch, math.pi)
        signs = self._setup.signs
        turn = signs.yaw * _number("attitude", "yaw_rate", message.yaw_rate, _FASTEST_TURN)
        self._compare(time, roll, signs.pitch * pitch, turn, message)
        return Inertial(roll=roll, pitch=signs.pitch * pitch, yaw_rate=turn)

    def _compare(
        self, time: float, roll: float, pitch: float, turn: float, message: Attitude
    ) -> None:
        """Refuse attitudes from when on turn rates or accelerations contradict them."""
        # The vertical along the axes of the chassis, and the rates about these
        x, y = math.sin(pitch), math.sin(roll)
        z = math.sqrt(max(_STEEPEST, 1 - x * x - y * y))  # of the vertical along the axes
        p, q = message.tilt_rates
        rates = p, q, (turn * (1 - x * x) - y * q) / z

        # Once contradicted, attitudes are not believed until all begins anew.
        sizes = self._tilts.add(time, (x, y, z), rates, message.acceleration)
        for name, size in sizes.items():
            if self._contradicted is None and (text := exceeds(name, size)):
                self._contradicted = Fault(name, text)
        if self._contradicted is not None:
            raise _RefusedError(self._contradicted)


def _refusal(
    device: str, name: str, problem: str, allowed: str, *, gap: bool = False
) -> _RefusedError:
    text = f"{device} {problem}; {allowed} is allowed"
    return _RefusedError(Fault(f"{device}_{name}", text, gap=gap))


def _offsets(values: Any) -> list[list[float]]:
    """Return what each joint of both pairs is off the angle of its pair."""
    try:
        front, rear = ([_number("joints", "offsets", a, _LARGEST_ANGLE) for a in p] for p in values)
    except (TypeError, ValueError):
        front = rear = []
    if front and rear:
        return [front, rear]
    raise _refusal("joints", "value", f"has offsets {short(values)}", "one for each joint")


def _check_frame(device: str, frame: object, allowed: str) -> None:
    if not isinstance(frame, str) or frame != allowed:
        raise _refusal(device, "frame", f"is in the frame {short(frame)!r}", repr(allowed))


def _number(device: str, name: str, value: object, limit: float) -> float:
    """Return a finite number of at most ``limit`` in magnitude."""
    number = real(value)
    if number is not None and math.isfinite(number) and abs(number) <= limit:
        return number
    allowed = "a finite number" if math.isinf(limit) else f"a number within ±{limit:.3g}"
    raise _refusal(device, "value", f"has {name} {short(value)}", allowed)
