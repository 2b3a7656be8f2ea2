"""Numbers of a bag that no driver filled in: orientations of 0 0 0 1, and speeds of 0.

Messages of ROS 2 that are left alone look like a level robot that stands. In: the messages of a
topic, and the poses of the recording. Out: what contradicts them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.ros.reading import seconds
from flipperctl.ros.transforms import Pose
from flipperctl.runtime.messages import Levels

Poses = Callable[[float], Pose | None]
"""Time → a frame in another, by the transforms of the recording."""
_TILTED = 0.1
"""Angle by which gravity or a mounting may lean while an orientation is level [rad]."""
_TURNED = 0.05
"""Angle by which the poses of the recording may meanwhile tilt [rad]."""
_GRAVITY = 7.0, 12.5
"""Magnitudes of an acceleration that is taken for gravity [m/s²]."""
_AVERAGED = 50
"""Accelerations of which the mean is taken for gravity [-]."""
_PERIOD = 0.1
"""Time between two poses of the recording that are looked up [s]."""
_PAUSE = 0.5
"""Time without a speed of 0 after which the robot has driven in between [s]."""
_MOVED = 0.15
"""Distance of a pose from that at the start of a stop, which noise does not make [m]."""
_SHARE = 0.75
"""Least share of the way that speeds of 0 in between must add up to, as of coarse encoders [-]."""


@dataclass(frozen=True)
class Orientations:
    """Which messages of an ``Imu`` hold an orientation."""

    messages: int
    blank: int
    """Messages that say so themselves, by a covariance of -1 or a quaternion of zeros."""
    level: int
    """Messages whose orientation is 0 0 0 1, if that is none."""
    reason: str = ""
    """Why it is none."""
    doubtful: bool = False
    """Whether all of them are 0 0 0 1 beside rates that are not 0, and nothing contradicts it."""

    def told(self, message: Any) -> bool:
        """Return whether a message holds an orientation."""
        return not (_blank(message) or (self.level and _level(message)))


def orientations(messages: Iterable[Any], chassis: Poses, mount: Pose | None) -> Orientations:
    """Return which messages of an ``Imu`` hold an orientation.

    ``chassis``: the chassis in the fixed frame; ``mount``: the unit on the chassis.
    """
    count = blank = level = 0
    found, gravity, ups = Levels(), list[FloatArray](), list[FloatArray]()
    leaning, looked, turning = 0.0, -math.inf, False
    for message in messages:
        count += 1
        if _blank(message):
            blank += 1
            continue
        time, q, rates = (
            seconds(message.header.stamp),
            message.orientation,
            message.angular_velocity,
        )
        is_level = _level(message)
        level += is_level
        turning = turning or any((rates.x, rates.y, rates.z))
        tilt = 0.0 if is_level else max(2 * math.asin(min(1, math.hypot(q.x, q.y))), 1e-9)
        found.add(time, tilt, (rates.x, rates.y))
        if not is_level:
            continue
        if time - looked >= _PERIOD and (pose := chassis(time)) is not None:
            looked = time
            ups.append(_up(pose))
        if message.linear_acceleration_covariance[0] != -1:
            a = message.linear_acceleration
            gravity.append(np.array([a.x, a.y, a.z]))
            if len(gravity) == _AVERAGED:
                mean, gravity = np.mean(gravity, axis=0), []
                size = float(np.linalg.norm(mean))
                if _GRAVITY[0] < size < _GRAVITY[1]:
                    leaning = max(leaning, _angle(mean / size, np.array([0.0, 0.0, 1.0])))
    tilted = max((_angle(ups[0], up) for up in ups[1:]), default=0.0)
    mounted = 0.0 if mount is None else _angle(_up(mount), np.array([0.0, 0.0, 1.0]))
    if found.unset:
        reason = found.unset
    elif level and tilted > _TURNED:
        reason = f"is 0 0 0 1, while the poses of the recording tilt by {math.degrees(tilted):.0f}°"
    elif level and leaning > _TILTED:
        reason = f"is 0 0 0 1, while gravity is {math.degrees(leaning):.0f}° from its z axis"
    elif level == count and level and mounted > _TILTED:
        reason = f"is 0 0 0 1, while it is mounted at {math.degrees(mounted):.0f}°"
    else:
        return Orientations(count, blank, 0, doubtful=turning and level == count)
    return Orientations(count, blank, level, reason)


def speed_unset(messages: Iterable[tuple[float, float, FloatArray | None]], chassis: Poses) -> str:
    """Return why the speeds of the belts were not filled in; nothing if they may be right.

    ``messages``: time [s], speed [m/s] and the place that the message tells, (3,) [m], if any.
    """
    own, recorded = _Stops(), _Stops()
    count = zeros = 0
    looked = -math.inf
    for time, speed, place in messages:
        count += 1
        own.drive(time, speed)
        recorded.drive(time, speed)
        if speed != 0:
            continue
        zeros += 1
        if place is not None:
            own.stand(time, place)
        if time - looked >= _PERIOD and (pose := chassis(time)) is not None:
            looked = time
            recorded.stand(time, pose.place)
    part = "" if zeros == count else f" in {zeros} of {count} messages"
    for stops, whose in ((own, "its pose moves"), (recorded, "the recorded poses move")):
        if (moved := stops.moved()) > 0:
            return f"its speed is 0{part} while {whose} {moved:.1f} m"
    return ""


class _Stops:
    """How far poses move while a speed is 0."""

    def __init__(self) -> None:
        self._start: FloatArray | None = None
        self._last = -math.inf  # time of the last speed of 0 [s]
        self._time: float | None = None
        self._far = self._driven = self._total = 0.0

    def drive(self, time: float, speed: float) -> None:
        """Add a speed."""
        if time - self._last > _PAUSE:
            self.moved()
            self._start = None
        if self._time is not None and math.isfinite(speed):
            self._driven += abs(speed) * max(0.0, time - self._time)
        self._time = time

    def stand(self, time: float, place: FloatArray) -> None:
        """Add the place at a time of a speed of 0."""
        if self._start is None:
            self._start, self._driven = place, 0.0
        self._last = time
        self._far = max(self._far, float(np.linalg.norm(place - self._start)))

    def moved(self) -> float:
        """Return how far the poses have moved in all stops [m]."""
        if self._far > _MOVED and self._driven < _SHARE * self._far:
            self._total += self._far
        self._far = self._driven = 0.0
        return self._total


def _blank(imu: Any) -> bool:
    q = imu.orientation
    length = math.hypot(q.x, q.y, q.z, q.w)
    return imu.orientation_covariance[0] == -1 or not 0.5 < length < 1.5


def _level(imu: Any) -> bool:
    q = imu.orientation
    return (q.x, q.y, q.z, abs(q.w)) == (0, 0, 0, 1)


def _up(pose: Pose) -> FloatArray:
    """Return the vertical in a posed frame, (3,)."""
    up: FloatArray = pose.inverse().directions(np.array([[0.0, 0.0, 1.0]]))[0]
    return up


def _angle(one: FloatArray, other: FloatArray) -> float:
    return math.acos(min(1.0, max(-1.0, float(one @ other))))
