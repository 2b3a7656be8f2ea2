"""The topics of a bag by the devices that they are of.

In: an opened bag, and what its topics, frames and joints are called. Out: device → topic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from flipperctl.bags.episode import BELTS
from flipperctl.bags.messages import BASE, JOINTS, ODOM
from flipperctl.bags.reading import ODOMETRY
from flipperctl.errors import RequestError
from flipperctl.messages import close_match

_SEARCHED = 1000
"""Messages of a topic that are searched for the joints of the flippers [-]."""
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
    return Names(clouds, imu, belts, fixed or ODOM, base, front, rear, signs)


def found_topics(path: Path, reader: Any, names: Names, remarks: list[str]) -> dict[str, str]:
    """Return the topics of the devices other than the LiDAR that can be used."""
    found = {}
    imu = _only(path, reader, names.imu, (_IMU,), "--imu")
    if imu is not None and (reason := _no_attitude(first(reader, imu))):
        remarks.append(f"{imu} is not used: {reason}")
    elif imu is not None:
        found["attitude"] = imu
    joints = _only(path, reader, None, (_JOINTS,), "", names)
    if joints is not None:
        found["joints"] = joints
    else:
        wanted = ", ".join([*names.front, *names.rear])
        remarks.append(f"no JointState has the joints {wanted}: the flippers are taken for level")
    belts = names.belts
    if belts is None and any(c.topic == BELTS for c in reader.connections):
        belts = BELTS
    belts = _only(path, reader, belts, (_NUMBER, ODOMETRY) if belts else (ODOMETRY,), "--belts")
    if belts is not None:
        found["odometry"] = belts
    return found


def _only(
    path: Path,
    reader: Any,
    topic: str | None,
    kinds: Sequence[str],
    option: str,
    joints: Names | None = None,
) -> str | None:
    """Return the topic, or the only one of these kinds; None if there is none.

    ``joints``: the names of the joints that its messages must have.

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
    if joints is not None:
        wanted = {*joints.front, *joints.rear}
        known = [topic for topic in known if _names_all(reader, topic, wanted)]
    if len(known) > 1 and option:
        raise RequestError(f"{path}: {option} chooses one of {', '.join(known)}")
    return known[0] if known else None


def first(reader: Any, topic: str) -> Any:
    """Return the first message of a topic; None if there is none."""
    return next(_messages(reader, topic), None)


def _messages(reader: Any, topic: str) -> Iterator[Any]:
    """Yield the messages of a topic."""
    chosen = [c for c in reader.connections if c.topic == topic]
    for connection, _, data in reader.messages(connections=chosen):
        yield reader.deserialize(data, connection.msgtype)


def _names_all(reader: Any, topic: str, wanted: set[str]) -> bool:
    """Return whether one of a topic's first messages has these joints; others may be of an arm."""
    few = islice(_messages(reader, topic), _SEARCHED)
    return any(wanted <= {*getattr(message, "name", ())} for message in few)


def _no_attitude(imu: Any) -> str:
    """Return why an ``Imu`` tells no attitude; nothing if it does."""
    if imu is None:
        return "it has no message"
    q = imu.orientation
    if imu.orientation_covariance[0] == -1 or not any((q.x, q.y, q.z, q.w)):
        return "it tells no orientation (a filter such as imu_filter_madgwick adds one)"
    return ""
