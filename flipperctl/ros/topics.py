"""The topics of a bag by the devices that they are of.

In: an opened bag, and what its topics, frames and joints are called. Out: topics that can be used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.errors import RequestError
from flipperctl.messages import close_match
from flipperctl.ros.episode import BELTS
from flipperctl.ros.messages import BASE, JOINTS, ODOM
from flipperctl.ros.reading import ODOMETRY, seconds
from flipperctl.ros.transforms import Pose, Transforms
from flipperctl.ros.unset import Orientations, orientations, speed_unset
from flipperctl.runtime.messages import ABSENT

_LISTED = 8
"""Joints of a bag that a remark names [-]."""
_IMU, _JOINTS, _NUMBER = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"


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


def names_of(
    clouds: str | None,
    imu: str | None,
    belts: str | None,
    fixed: str | None,
    base: str,
    front: Sequence[str] | None,
    rear: Sequence[str] | None,
    signs: str,
) -> Names:
    """Return the names that a command was given; None stands for the usual ones."""
    front, rear = tuple(front or JOINTS[:2]), tuple(rear or JOINTS[2:])
    fixed, base = (fixed or ODOM).lstrip("/"), base.lstrip("/")
    return Names(clouds, imu, belts, fixed, base, front, rear, signs)


@dataclass(frozen=True)
class Devices:
    """The topics of the devices other than the LiDAR that can be used."""

    attitude: str | None = None
    belts: str | None = None
    joints: Mapping[str, Collection[str]] = field(default_factory=dict)
    """Topic → the joints whose angles come from it."""
    imu: Orientations | None = None
    """Which messages of ``attitude`` hold one."""


def found_devices(
    path: Path, reader: Any, names: Names, transforms: Transforms, remarks: list[str]
) -> Devices:
    """Return the topics of the devices other than the LiDAR that can be used."""

    def pose(frame: str, of: str, time: float) -> Pose | None:
        try:
            return transforms.pose(frame, of, time)
        except RequestError:  # it is told where it is needed
            return None

    def chassis(time: float) -> Pose | None:
        return pose(names.fixed, names.base, time)

    attitude = _only(path, reader, names.imu, (_IMU,), "--imu")
    imu = None
    if attitude is not None:
        head = first(reader, attitude)
        frame = names.base if head is None else head.header.frame_id.lstrip("/")
        mount = None if head is None else pose(names.base, frame, seconds(head.header.stamp))
        imu = orientations(_messages(reader, attitude), chassis, mount)
        if text := _unused(attitude, imu):
            remarks.append(text)
        attitude = None if imu.blank + imu.level == imu.messages else attitude
    joints, text = _joint_topics(reader, names)
    if text:
        remarks.append(text)
    belts = names.belts
    if belts is None and any(c.topic == BELTS for c in reader.connections):
        belts = BELTS
    belts = _only(path, reader, belts, (_NUMBER, ODOMETRY) if belts else (ODOMETRY,), "--belts")
    if belts is not None and (reason := speed_unset(_speeds(reader, belts), chassis)):
        remarks.append(f"{belts} is not used for the belts: {reason}")
        belts = None
    return Devices(attitude, belts, joints, imu)


def _unused(topic: str, imu: Orientations) -> str:
    """Return what to remark on an inertial unit; nothing if all its messages are used."""
    if not imu.messages:
        return f"{topic} is not used: it has no message"
    if imu.doubtful:
        return f"{topic}: each orientation is 0 0 0 1, as if no one fills it in: taken for level"
    reason = f"it {imu.reason}" if imu.level else "its covariance or quaternion says so"
    lost = imu.blank + imu.level
    if lost == imu.messages:
        return f"{topic} is not used: it tells no orientation ({reason}); {ABSENT}"
    if lost:
        return (
            f"{topic}: {lost} of {imu.messages} messages tell no orientation ({reason}); {ABSENT}"
        )
    return ""


def _speeds(reader: Any, topic: str) -> Iterator[tuple[float, float, FloatArray | None]]:
    """Yield time, speed and place of the messages of the belts' speed."""
    for received, message in _received(reader, topic):
        if not hasattr(message, "twist"):
            yield received, float(message.data), None
            continue
        p = message.pose.pose.position
        place = np.array([p.x, p.y, p.z])
        yield seconds(message.header.stamp), float(message.twist.twist.linear.x), place


def _joint_topics(reader: Any, names: Names) -> tuple[dict[str, list[str]], str]:
    """Return from which topics the angles of which joints come, and what to remark on the others.

    One topic with all joints is taken before several with a part each.
    """
    wanted = list(dict.fromkeys([*names.front, *names.rear]))
    topics = sorted({c.topic for c in reader.connections if c.msgtype == _JOINTS})
    others = dict.fromkeys(name for topic in topics for name in _others(reader, topic, wanted))
    has = {topic: _joints_in(reader, topic, wanted) for topic in topics}
    found: dict[str, list[str]] = {}
    left = list(wanted)
    for topic in sorted(topics, key=lambda one: -len(has[one])):
        if taken := [name for name in left if name in has[topic]]:
            found[topic] = taken
            left = [name for name in left if name not in taken]
    if not left:
        return found, ""
    known = [name for name in wanted if name not in left]
    there = f", only {', '.join(known)}" if known else ""
    if not known and others:
        there = f"; the bag has {', '.join([*others][:_LISTED])} (--front and --rear name them)"
    missing = f"no JointState has the joint{'s' if len(left) > 1 else ''} {', '.join(left)}{there}"
    return {}, f"{missing}: the flippers are taken for level"


def _joints_in(reader: Any, topic: str, wanted: Sequence[str]) -> set[str]:
    """Return the wanted joints that the messages of a topic have, all or a part in each."""
    found: set[str] = set()
    chosen = [c for c in reader.connections if c.topic == topic]
    for connection, _, data in reader.messages(connections=chosen):
        # Most messages are of known or other joints: their bytes are searched before they are read.
        if any(name not in found and name.encode() in data for name in wanted):
            message = reader.deserialize(data, connection.msgtype)
            found |= {*message.name[: len(message.position)]} & {*wanted}
        if len(found) == len(wanted):
            break
    return found


def _others(reader: Any, topic: str, wanted: Sequence[str]) -> Sequence[str]:
    message = first(reader, topic)
    return [] if message is None else [name for name in message.name if name not in wanted]


def _only(
    path: Path,
    reader: Any,
    topic: str | None,
    kinds: Sequence[str],
    option: str,
) -> str | None:
    """Return the topic, or the only one of these kinds; None if there is none.

    Raises:
        RequestError: there is no such topic, or there are several.
    """
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
    return known[0] if known else None


def first(reader: Any, topic: str) -> Any:
    """Return the first message of a topic; None if there is none."""
    return next(_messages(reader, topic), None)


def _messages(reader: Any, topic: str) -> Iterator[Any]:
    """Yield the messages of a topic."""
    for _, message in _received(reader, topic):
        yield message


def _received(reader: Any, topic: str) -> Iterator[tuple[float, Any]]:
    """Yield the messages of a topic, and when each was recorded [s]."""
    chosen = [c for c in reader.connections if c.topic == topic]
    for connection, stamp, data in reader.messages(connections=chosen):
        yield stamp * 1e-9, reader.deserialize(data, connection.msgtype)
