"""The topics of a bag by the devices that they are of, without those that no driver filled in.

In: an opened bag, and what its topics, frames and joints are called. Out: topics that can be used.
Messages of ROS 2 that are left alone look like a level robot that stands: orientations of 0 0 0 1,
and speeds of 0. The poses of the recording, rates and gravity contradict them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.errors import RequestError
from flipperctl.messages import close_match
from flipperctl.ros.episode import BELTS
from flipperctl.ros.messages import BASE, JOINTS, ODOM
from flipperctl.ros.reading import ODOMETRY, Pose, Transforms, messages, seconds
from flipperctl.runtime.messages import ABSENT, Levels

_LISTED = 8
"""Joints of a bag that a remark names [-]."""
_IMU, _JOINTS, _NUMBER = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"
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
class Names:
    """What the topics, frames and joints of a bag are called."""

    clouds: str | None = None
    """Topic of the clouds; None: the only one."""
    imu: str | None = None
    """Topic of the inertial unit; None: the only one, if there is one."""
    belts: str | None = None
    """Topic of the belts' speed, a ``Float64`` or an ``Odometry``; None: the only one of them."""
    fixed: str = ODOM
    """Frame in which the ground is at rest."""
    base: str = BASE
    """Frame of the chassis."""
    front: Sequence[str] = JOINTS[:2]
    """Joints of the front flippers."""
    rear: Sequence[str] = JOINTS[2:]
    """Joints of the rear flippers."""
    signs: str = "rep103"
    """Convention of the flippers' angles."""

    def __post_init__(self) -> None:
        """Take frames as tf2 does, without a slash at the beginning."""
        for name in ("fixed", "base"):
            object.__setattr__(self, name, getattr(self, name).lstrip("/"))


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


def found_devices(
    path: Path, reader: Any, names: Names, transforms: Transforms, remarks: list[str]
) -> tuple[str | None, Orientations | None, str | None, dict[str, list[str]]]:
    """Return the topics of the devices other than the LiDAR that can be used.

    That of attitudes, and which of its messages hold one; that of the belts; and those of joints,
    with the joints whose angles come from each.
    """

    def pose(frame: str, of: str, time: float) -> Pose | None:
        try:
            return transforms.pose(frame, of, time)
        except RequestError:  # it is told where it is needed
            return None

    chassis = partial(pose, names.fixed, names.base)
    attitude = _only(path, reader, names.imu, (_IMU,), "--imu")
    imu = None
    if attitude is not None:
        head = _first(reader, attitude)
        frame = names.base if head is None else head.header.frame_id.lstrip("/")
        mount = None if head is None else pose(names.base, frame, seconds(head.header.stamp))
        imu = orientations((m for *_, m in messages(reader, [attitude])), chassis, mount)
        remarks += _unused(attitude, imu)
        attitude = None if imu.blank + imu.level == imu.messages else attitude
    joints = _joint_topics(reader, names, remarks)
    belts = names.belts
    if belts is None and any(c.topic == BELTS for c in reader.connections):
        belts = BELTS
    belts = _only(path, reader, belts, (_NUMBER, ODOMETRY) if belts else (ODOMETRY,), "--belts")
    if belts is not None and (reason := speed_unset(_speeds(reader, belts), chassis)):
        remarks.append(f"{belts} is not used for the belts: {reason}")
        belts = None
    return attitude, imu, belts, joints


def _unused(topic: str, imu: Orientations) -> list[str]:
    """Return what to remark on an inertial unit; nothing if all its messages are used."""
    lost = imu.blank + imu.level
    if not imu.messages:
        return [f"{topic} is not used: it has no message"]
    if imu.doubtful:
        return [f"{topic}: each orientation is 0 0 0 1, as if no one fills it in: taken for level"]
    if not lost:
        return []
    reason = f"it {imu.reason}" if imu.level else "its covariance or quaternion says so"
    part = f": {lost} of {imu.messages} messages tell no orientation"
    if lost == imu.messages:
        part = " is not used: it tells no orientation"
    return [f"{topic}{part} ({reason}); {ABSENT}"]


def _speeds(reader: Any, topic: str) -> Iterator[tuple[float, float, FloatArray | None]]:
    """Yield time, speed and place of the messages of the belts' speed."""
    for _, received, message in messages(reader, [topic]):
        if not hasattr(message, "twist"):
            yield received, float(message.data), None
            continue
        p = message.pose.pose.position
        place = np.array([p.x, p.y, p.z])
        yield seconds(message.header.stamp), float(message.twist.twist.linear.x), place


def _joint_topics(reader: Any, names: Names, remarks: list[str]) -> dict[str, list[str]]:
    """Return from which topics the angles of which joints come; none unless there are all.

    One topic with all joints is taken before several with a part each.
    """
    wanted = list(dict.fromkeys([*names.front, *names.rear]))
    topics = sorted({c.topic for c in reader.connections if c.msgtype == _JOINTS})
    has = {topic: _joints_in(reader, topic, wanted) for topic in topics}
    joints: dict[str, list[str]] = {}
    left = list(wanted)
    for topic in sorted(topics, key=lambda one: -len(has[one])):
        if taken := [name for name in left if name in has[topic]]:
            joints[topic] = taken
            left = [name for name in left if name not in taken]
    if not left:
        return joints
    known = [name for name in wanted if name not in left]
    heads = [_first(reader, topic) for topic in topics]
    others = dict.fromkeys(n for one in heads if one for n in one.name if n not in wanted)
    there = f", only {', '.join(known)}" if known else ""
    if not known and others:
        there = f"; the bag has {', '.join([*others][:_LISTED])} (--front and --rear name them)"
    missing = f"the joint{'s' if len(left) > 1 else ''} {', '.join(left)}"
    remarks.append(f"no JointState has {missing}{there}: the flippers are taken for level")
    return {}


def _joints_in(reader: Any, topic: str, wanted: Sequence[str]) -> set[str]:
    """Return the wanted joints that the messages of a topic have, all or a part in each."""
    names: set[str] = set()
    chosen = [c for c in reader.connections if c.topic == topic]
    for connection, _, data in reader.messages(chosen):
        # Most messages are of known or other joints: their bytes are searched before they are read.
        if any(name not in names and name.encode() in data for name in wanted):
            message = reader.deserialize(data, connection.msgtype)
            names |= {*message.name[: len(message.position)]} & {*wanted}
        if len(names) == len(wanted):
            break
    return names


def _only(
    path: Path, reader: Any, topic: str | None, kinds: Sequence[str], option: str
) -> str | None:
    """Return the topic, or the only one of these kinds; None if there is none."""
    known = sorted({c.topic for c in reader.connections if c.msgtype in kinds})
    if topic is not None:
        if topic not in known:
            kind = " or ".join(one.rpartition("/")[2] for one in kinds)
            hint = close_match(topic, known)
            topics = ", ".join(known) or "none"
            raise RequestError(f"{path}: no {kind} is on {topic!r}{hint}; topics: {topics}")
        return topic
    if len(known) > 1:
        raise RequestError(f"{path}: {option} chooses one of {', '.join(known)}")
    return next(iter(known), None)


def _first(reader: Any, topic: str) -> Any:
    """Return the first message of a topic; None if there is none."""
    return next((message for *_, message in messages(reader, [topic])), None)


def orientations(received: Iterable[Any], chassis: Poses, mount: Pose | None) -> Orientations:
    """Return which messages of an ``Imu`` hold an orientation.

    ``chassis``: the chassis in the fixed frame; ``mount``: the unit on the chassis.
    """
    count = blank = level = 0
    levels, gravity, ups = Levels(), list[list[float]](), list[FloatArray]()
    leaning, looked, turning = 0.0, -math.inf, False
    vertical = np.array([0.0, 0.0, 1.0])
    for message in received:
        count += 1
        if _blank(message):
            blank += 1
            continue
        time, q = seconds(message.header.stamp), message.orientation
        rates = message.angular_velocity
        is_level = _level(message)
        level += is_level
        turning = turning or any((rates.x, rates.y, rates.z))
        tilt = 0.0 if is_level else max(2 * math.asin(min(1, math.hypot(q.x, q.y))), 1e-9)
        levels.add(time, tilt, (rates.x, rates.y))
        if not is_level:
            continue
        if time - looked >= _PERIOD and (pose := chassis(time)) is not None:
            looked = time
            ups.append(_up(pose))
        if message.linear_acceleration_covariance[0] != -1:
            a = message.linear_acceleration
            gravity.append([a.x, a.y, a.z])
            if len(gravity) == _AVERAGED:
                mean, gravity = np.mean(gravity, axis=0), []
                size = float(np.linalg.norm(mean))
                if _GRAVITY[0] < size < _GRAVITY[1]:
                    leaning = max(leaning, _angle(mean / size, vertical))
    tilted = max((_angle(ups[0], up) for up in ups[1:]), default=0.0)
    mounted = 0.0 if mount is None else _angle(_up(mount), vertical)
    if levels.unset:
        reason = levels.unset
    elif level and tilted > _TURNED:
        reason = f"is 0 0 0 1, while the poses of the recording tilt by {math.degrees(tilted):.0f}°"
    elif level and leaning > _TILTED:
        reason = f"is 0 0 0 1, while gravity is {math.degrees(leaning):.0f}° from its z axis"
    elif level == count and level and mounted > _TILTED:
        reason = f"is 0 0 0 1, while it is mounted at {math.degrees(mounted):.0f}°"
    else:
        return Orientations(count, blank, 0, doubtful=turning and level == count)
    return Orientations(count, blank, level, reason)


def speed_unset(received: Iterable[tuple[float, float, FloatArray | None]], chassis: Poses) -> str:
    """Return why the speeds of the belts were not filled in; nothing if they may be right.

    ``received``: time [s], speed [m/s] and the place that the message tells, (3,) [m], if any.
    """
    own, recorded = _Stops(), _Stops()
    count = zeros = 0
    looked = -math.inf
    for time, speed, place in received:
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
