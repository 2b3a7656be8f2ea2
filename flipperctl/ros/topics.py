"""Finds the topics of a robot's devices in a bag.

In: an opened bag, and what its topics, frames and joints are called. Out: topics that can be used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flipperctl.core.lidar.body import Mount
from flipperctl.errors import RequestError
from flipperctl.ros.episode import BELTS
from flipperctl.ros.messages import BASE, JOINTS, ODOM
from flipperctl.ros.reading import CLOUD, ODOMETRY, messages
from flipperctl.runtime.devices import Devices
from flipperctl.text.messages import close_match

_LISTED = 10
"""Topics or joints of a bag that a remark names [-]."""
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
    """Joints of the front flippers; one with a - before it counts the other way."""
    rear: Sequence[str] = JOINTS[2:]
    """Joints of the rear flippers, likewise."""
    signs: str = "rep103"
    """Convention of the flippers' angles."""
    scale: float = 1.0
    """Angle of 1 in a message [rad]."""
    belt_scale: float = 1.0
    """Speed of the belts of 1 in a message [m/s]."""
    mount: Mount | None = None
    """Where the LiDAR is, if the bag has no transform of its frame."""
    likely: Sequence[str] = ()
    """Topics that are taken where several could be meant."""
    command: str = ""
    """Topic of the joints' commands, which measures no angle."""

    @classmethod
    def of(cls, devices: Devices, **others: Any) -> Names:
        """Return what the devices are called; ``others`` are taken instead, unless None."""
        joints, frames, topics = devices.joints, devices.frames, devices.topics
        names: dict[str, Any] = {
            "fixed": frames.fixed,
            "base": frames.base,
            "front": joints.front,
            "rear": joints.rear,
            "signs": joints.signs,
            "scale": joints.scale,
            "belt_scale": devices.belts.scale,
            "mount": devices.mount,
            "likely": (topics.clouds, topics.imu, topics.belts),
            "command": f"/{topics.joint_command.lstrip('/')}",
        }
        return cls(**(names | {name: value for name, value in others.items() if value is not None}))

    def __post_init__(self) -> None:
        """Take frames as tf2 does, without a slash at the beginning."""
        for name in ("fixed", "base"):
            object.__setattr__(self, name, getattr(self, name).lstrip("/"))


@dataclass(frozen=True)
class Topics:
    """The topics of a robot's devices."""

    clouds: str
    """Topic of the clouds; empty if they are left out."""
    attitude: str | None = None
    """Topic of an ``Imu``."""
    belts: str | None = None
    """Topic of the belts' speed."""
    joints: Mapping[str, Collection[str]] = field(default_factory=dict)
    """Topic → the joints whose angles come from it."""


def found_devices(
    path: Path, reader: Any, names: Names, remarks: list[str], *, clouds: bool = True
) -> Topics:
    """Return the topics of the devices that a bag has; ``remarks`` receives what is missing.

    ``clouds``: whether it must have clouds; else they are left out.
    """
    scans = cloud_topic(path, reader, names) if clouds else ""
    attitude = _only(path, reader, names.imu, (_IMU,), "--imu", names.likely)
    joints = _joint_topics(reader, names, remarks)
    # The robot's own belts come first, since its bags have odometry as well.
    belts, usual = names.belts, {BELTS, *(f"/{name.lstrip('/')}" for name in names.likely)}
    if belts is None:
        numbers = (c.topic for c in reader.connections if c.msgtype == _NUMBER)
        belts = next((topic for topic in numbers if topic in usual), None)
    kinds = (_NUMBER, ODOMETRY) if belts else (ODOMETRY,)
    belts = _only(path, reader, belts, kinds, "--belts", names.likely)
    return Topics(scans, attitude, belts, joints)


def _joint_topics(reader: Any, names: Names, remarks: list[str]) -> dict[str, list[str]]:
    """Return topic → joints whose angles come from it; empty unless all joints are found.

    One topic with all joints is taken before several with a part each.
    """
    # Fewest topics: those with the most of the wanted joints first
    wanted = list(dict.fromkeys(name.lstrip("-") for name in (*names.front, *names.rear)))
    topics = sorted({c.topic for c in reader.connections if c.msgtype == _JOINTS} - {names.command})
    has = {topic: _joints_in(reader, topic, wanted) for topic in topics}
    joints: dict[str, list[str]] = {}
    left = list(wanted)
    for topic in sorted(topics, key=lambda name: -len(has[name])):
        if taken := [name for name in left if name in has[topic]]:
            joints[topic] = taken
            left = [name for name in left if name not in taken]
    if not left:
        return joints

    # What is missing, and what could have been meant
    known = [name for name in wanted if name not in left]
    heads = [_first(reader, topic) for topic in topics]
    others = dict.fromkeys(n for head in heads if head for n in head.name if n not in wanted)
    there = f", only {', '.join(known)}" if known else ""
    if not known and others:
        there = f"; the bag has {', '.join([*others][:_LISTED])} (--front and --rear name them)"
    missing = f"the joint{'s' if len(left) > 1 else ''} {', '.join(left)}"
    remarks.append(f"no JointState has {missing}{there}: the flippers are taken for level")
    return {}


def _joints_in(reader: Any, topic: str, wanted: Sequence[str]) -> set[str]:
    """Return the wanted joints that the messages of a topic have, all or a part in each."""
    names: set[str] = set()
    connections = [c for c in reader.connections if c.topic == topic]
    for connection, _, data in reader.messages(connections):
        # Most messages are of known or other joints: their bytes are searched before they are read.
        if any(name not in names and name.encode() in data for name in wanted):
            message = reader.deserialize(data, connection.msgtype)
            names |= {*message.name[: len(message.position)]} & {*wanted}
        if len(names) == len(wanted):
            break
    return names


def _only(
    path: Path,
    reader: Any,
    topic: str | None,
    kinds: Sequence[str],
    option: str,
    likely: Iterable[str],
) -> str | None:
    """Return the topic, or the only one of these kinds; None if there is none."""
    known = sorted({c.topic for c in reader.connections if c.msgtype in kinds})
    if topic is None and len(known) > 1:
        usual = {f"/{name.lstrip('/')}" for name in likely}
        topic = next((name for name in known if name in usual), None)
    if topic in known or (topic is None and len(known) < 2):
        return topic or next(iter(known), None)
    kind = " or ".join(name.rpartition("/")[2] for name in kinds)
    problem = f"no {kind} is on {topic!r}{close_match(topic or '', known)}"
    if topic is None:
        problem = f"several topics have {kind}; {option} chooses one"
    raise RequestError(f"{path}: {problem}; topics: {', '.join(known) or 'none'}")


def cloud_topic(path: Path, reader: Any, names: Names) -> str:
    """Return the topic of the clouds, which is needed."""
    if topic := _only(path, reader, names.clouds, (CLOUD,), "--topic", names.likely):
        return topic
    kinds = {c.topic: c.msgtype.replace("/msg/", "/") for c in reader.connections}
    has = [f"{name} ({kind})" for name, kind in sorted(kinds.items())]
    more = f" and {len(has) - _LISTED} more" if len(has) > _LISTED else ""
    raise RequestError(
        f"{path}: the PointCloud2 of one topic is needed; topics: none; the bag has "
        f"{', '.join(has[:_LISTED]) or 'no message'}{more}"
    )


def _first(reader: Any, topic: str) -> Any:
    """Return the first message of a topic; None if there is none."""
    return next((message for *_, message in messages(reader, [topic])), None)
