"""Read point clouds and the frames in which they were measured from a bag.

In: a bag of ROS 1 or ROS 2, such as a folder of ``ros2 bag record``, an ``.mcap`` or a ``.bag``.
Out: clouds with their stamps and frames, and the tree of transforms.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.bags.episode import typestore
from flipperctl.bags.messages import TIME, require_rosbags
from flipperctl.bags.transforms import Pose, Transforms
from flipperctl.errors import RequestError
from flipperctl.messages import close_match

CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
FRAMES = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_STATIC = "tf_static"
_NUMBERS = {7: "f4", 8: "f8"}
"""Datatype of a field → type of numpy."""
_SLICE = 0.01
"""Points of a turning LiDAR are taken for simultaneous within this time [s]."""
_METADATA = "metadata.yaml"
_LONGEST_TURN = 1.0
"""Largest time of a point before or after the stamp of its cloud [s]."""
_DAMAGED = (
    *(ArithmeticError, AssertionError, EOFError, LookupError, MemoryError, OSError, RuntimeError),
    *(TypeError, ValueError),
    struct.error,
)
"""What readers raise at bytes that make no sense."""


@dataclass(frozen=True)
class Cloud:
    """The points of one scan."""

    time: float
    """Its stamp [s]."""
    frame: str
    points: FloatArray
    """(P, 3) finite points in that frame [m]."""
    message: int = 0
    """Number of its message in the bag; a message with times of its points has several clouds."""


@dataclass(frozen=True)
class Points:
    """The points of one message."""

    time: float
    """The stamp of the message [s]."""
    frame: str
    points: FloatArray
    """(P, 3) finite points in that frame [m]."""
    shifts: FloatArray | None
    """(P,) time of each point after the stamp, negative before it [s]; None: they have none."""


@dataclass(frozen=True)
class Bag:
    """The clouds of one topic, and all transforms."""

    topic: str
    clouds: Sequence[Cloud]
    transforms: Transforms


def read_bag(path: Path, topic: str | None = None) -> Bag:
    """Return the clouds of a topic, by default of the only one, and all transforms.

    The pose of an odometry is a transform as well, for a frame that has no other.

    Raises:
        MissingExtraError: rosbags is not installed.
        RequestError: the file is no bag, there is no such topic, or the clouds have no stamps.
    """
    transforms, clouds, odometry = Transforms(), list[Cloud](), []
    messages = 0
    with opened(path) as reader:
        chosen = chosen_topic(path, reader, topic)
        for connection, _, data in reader.messages():
            kind = connection.msgtype
            if connection.topic == chosen:
                read = reader.deserialize(data, kind)
                clouds += _clouds(f"{path}: {chosen}", read, messages)
                messages += 1
            elif kind in FRAMES:
                add_transforms(transforms, connection.topic, reader.deserialize(data, kind))
            elif kind == ODOMETRY:
                odometry.append((connection.topic, reader.deserialize(data, kind)))
    add_odometry(path, transforms, odometry)
    return Bag(chosen, clouds, transforms)


def add_transforms(transforms: Transforms, topic: str, message: Any) -> None:
    """Add the transforms of a message of tf; those of ``tf_static`` are fixed."""
    static = topic.rstrip("/").endswith(_STATIC)
    for one in message.transforms:
        place, turn = one.transform.translation, one.transform.rotation
        time = None if static else seconds(one.header.stamp)
        transforms.add(one.header.frame_id, one.child_frame_id, time, _pose(place, turn))


def add_odometry(path: Path, transforms: Transforms, odometry: Sequence[tuple[str, Any]]) -> None:
    """Add the poses of the messages of odometry, with their topics, for frames without another.

    Raises:
        RequestError: several topics tell the pose of one frame, and no transform does.
    """
    topics: dict[str, set[str]] = {}
    for topic, one in odometry:
        if not transforms.has(one.child_frame_id):
            topics.setdefault(one.child_frame_id, set()).add(topic)
    for frame, names in topics.items():
        if len(names) > 1:
            raise RequestError(
                f"{path}: the poses of {frame!r} come from {' and '.join(sorted(names))}, and from "
                "no transform; a bag with one of them, or with tf, is allowed"
            )
    without = topics.keys()
    for _, one in odometry:
        if one.child_frame_id in without:
            place, turn = one.pose.pose.position, one.pose.pose.orientation
            time, pose = seconds(one.header.stamp), _pose(place, turn)
            transforms.add(one.header.frame_id, one.child_frame_id, time, pose)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a bag; an error of its content names the file."""
    require_rosbags("reading a bag")
    from rosbags import rosbag1, rosbag2
    from rosbags.highlevel import AnyReader, AnyReaderError

    if not path.exists():
        raise RequestError(f"{path}: there is no such file or folder")
    if path.is_dir() and not (path / _METADATA).exists():
        raise RequestError(
            f"{path}: this folder has neither {_METADATA}, as a bag of ROS 2, nor poses.txt, as a "
            "folder of clouds"
        )
    # A bag without definitions of its types, as of early ROS 2, has those of the distribution.
    try:
        with AnyReader([path], default_typestore=typestore()) as reader:
            yield reader
    except (AnyReaderError, rosbag1.ReaderError, rosbag2.ReaderError, *_DAMAGED) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise RequestError(f"{path} cannot be read as a bag: {text}") from error


def chosen_topic(path: Path, reader: Any, topic: str | None) -> str:
    """Return the topic of clouds, the only one unless it is named."""
    clouds = sorted({c.topic for c in reader.connections if c.msgtype == CLOUD})
    known = ", ".join(clouds) or "none"
    if topic is not None:
        if topic not in clouds:
            hint = close_match(topic, clouds)
            raise RequestError(f"{path}: no PointCloud2 is on {topic!r}{hint}; topics: {known}")
        return topic
    if len(clouds) != 1:
        raise RequestError(
            f"{path}: the PointCloud2 of one topic is needed; topics: {known}; --topic chooses one"
        )
    found: str = clouds[0]
    return found


def _clouds(where: str, message: Any, number: int) -> list[Cloud]:
    """Return the points of a message, those of about one instant as one cloud."""
    found = read_points(where, message)
    if found.shifts is None:
        return [Cloud(found.time, found.frame, found.points, number)]
    slices = np.round(found.shifts / _SLICE).astype(np.int64)
    return [
        Cloud(found.time + _SLICE * one, found.frame, found.points[slices == one], number)
        for one in np.unique(slices)
    ]


def read_points(where: str, message: Any) -> Points:
    """Return what a ``PointCloud2`` holds.

    Raises:
        RequestError: it has no stamp, no frame or no coordinates; the text begins with ``where``.
    """
    time, frame = seconds(message.header.stamp), message.header.frame_id.lstrip("/")
    if time == 0:
        raise RequestError(
            f"{where}: a cloud has no stamp (header.stamp is 0), so that its pose is unknown; "
            "record the driver's messages, not those of a node that drops the header"
        )
    if not frame:
        raise RequestError(f"{where}: a cloud has no frame (header.frame_id is empty)")
    fields = {one.name: one for one in message.fields}
    for name in "xyz":
        if name not in fields or fields[name].datatype not in _NUMBERS:
            known = ", ".join(fields) or "none"
            raise RequestError(f"{where}: a cloud needs x, y and z as floats; fields: {known}")
    timed = TIME in fields and fields[TIME].datatype in _NUMBERS
    names = [*"xyz", *([TIME] if timed else [])]
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": names,
            "formats": [order + _NUMBERS[fields[name].datatype] for name in names],
            "offsets": [fields[name].offset for name in names],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.row_step)
    data = rows[:, : message.width * message.point_step].tobytes()
    found = np.frombuffer(data, layout)
    points = np.column_stack([found[name].astype(np.float64) for name in "xyz"])
    kept = np.isfinite(points).all(axis=1)
    if not timed:
        return Points(time, frame, points[kept], None)
    shifts = found[TIME].astype(np.float64)
    kept &= np.abs(shifts) <= _LONGEST_TURN  # others are of another unit or clock
    return Points(time, frame, points[kept], shifts[kept])


def _pose(place: Any, turn: Any) -> Pose:
    return Pose(np.array([place.x, place.y, place.z]), np.array([turn.x, turn.y, turn.z, turn.w]))


def seconds(stamp: Any) -> float:
    """Return a stamp as one number [s]."""
    return float(stamp.sec + stamp.nanosec * 1e-9)
