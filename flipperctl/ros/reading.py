"""Read point clouds and the frames in which they were measured, from a bag or a folder.

In: a bag of ROS 1 or ROS 2, such as a folder of ``ros2 bag record``, an ``.mcap`` or a ``.bag``; or
files of clouds and ``poses.txt`` with one line for each of them in the order of their names, 2
before 10: 8 numbers, stamp, place and quaternion (x y z qx qy qz qw), as TUM's tools write them, or
12, the upper rows of the matrix, as KITTI's do. Out: clouds with their stamps and frames, and the
tree of transforms.
"""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.errors import MissingExtraError, RequestError
from flipperctl.messages import close_match
from flipperctl.ros.episode import typestore
from flipperctl.ros.messages import require_rosbags
from flipperctl.ros.transforms import Pose, Transforms
from flipperctl.runtime.point_cloud import PointTimes, read_cloud

CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
FRAMES = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_STATIC = "tf_static"
_SLICE = 0.01
"""Points of a turning LiDAR are taken for simultaneous within this time [s]."""
_METADATA = "metadata.yaml"
_FILES = {
    ".mcap": "'mcap recover {} -o whole.mcap'",
    ".db3": "'ros2 bag reindex' on its folder",
    ".bag": "'rosbag reindex {}'",
}
"""Suffix of a bag's file → what mends one."""
_MAGIC = {".mcap": b"\x89MCAP", ".db3": b"SQLite format 3", ".bag": b"#ROSBAG"}
_LISTED = 12
"""Topics of a bag that an error names [-]."""
_UNIT = 0.05
"""Most by which the length of a quaternion may differ from 1 [-]."""
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
    messages: int
    """Number of its messages, of which some may have no point."""
    transforms: Transforms
    remarks: Sequence[str]
    """What a reader of the result should know."""


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
        where, times = f"{path}: {chosen}", times_of(path, reader, chosen)
        for connection, _, data in reader.messages():
            kind = connection.msgtype
            if connection.topic == chosen:
                read = reader.deserialize(data, kind)
                clouds += _clouds(read_points(where, read, times), messages)
                messages += 1
            elif kind in FRAMES:
                add_transforms(transforms, connection.topic, reader.deserialize(data, kind))
            elif kind == ODOMETRY:
                odometry.append((connection.topic, reader.deserialize(data, kind)))
    add_odometry(path, transforms, odometry)
    return Bag(chosen, clouds, messages, transforms, [f"{chosen}: {r}" for r in times.remarks()])


def add_transforms(transforms: Transforms, topic: str, message: Any) -> None:
    """Add the transforms of a message of tf; those of ``tf_static`` are fixed."""
    static = topic.rstrip("/").endswith(_STATIC)
    for one in message.transforms:
        place, turn = one.transform.translation, one.transform.rotation
        time, pose = None if static else seconds(one.header.stamp), _pose(place, turn)
        if pose is not None:
            transforms.add(one.header.frame_id, one.child_frame_id, time, pose)


def add_odometry(path: Path, transforms: Transforms, odometry: Sequence[tuple[str, Any]]) -> None:
    """Add the poses of the messages of odometry, with their topics, for frames without another.

    Raises:
        RequestError: several topics tell the pose of one frame, and no transform does.
    """
    topics: dict[str, set[str]] = {}
    for topic, one in odometry:
        if not transforms.has(one.child_frame_id):
            topics.setdefault(one.child_frame_id.lstrip("/"), set()).add(topic)
    for frame, names in topics.items():
        if len(names) > 1:
            raise RequestError(
                f"{path}: the poses of {frame!r} come from {' and '.join(sorted(names))}, and from "
                "no transform; a bag with one of them, or with tf, is allowed"
            )
    without = topics.keys()
    for _, one in odometry:
        if one.child_frame_id.lstrip("/") in without:
            place, turn = one.pose.pose.position, one.pose.pose.orientation
            time, pose = seconds(one.header.stamp), _pose(place, turn)
            if pose is not None:
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
        inside = sorted(one.name for one in path.iterdir() if one.suffix in _FILES)
        hint = f"; {' and '.join(inside[:3])} in it can be given itself" if inside else ""
        raise RequestError(
            f"{path}: this folder has neither {_METADATA}, as a bag of ROS 2, nor poses.txt, as a "
            f"folder of clouds{hint}"
        )
    # A bag without definitions of its types, as of early ROS 2, has those of the distribution.
    try:
        with AnyReader([path], default_typestore=typestore()) as reader:
            yield reader
    except (AnyReaderError, rosbag1.ReaderError, rosbag2.ReaderError, *_DAMAGED) as error:
        text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise RequestError(f"{path} cannot be read as a bag: {text}{_remedy(path)}") from error


def _remedy(path: Path) -> str:
    """Return what makes a whole bag of one that was never closed, as after a loss of power."""
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in inside:
        if (tool := _FILES.get(file.suffix)) and _begins_as(file):
            return f"; if the recording was cut off, {tool.format(file)} mends it"
    return ""


def _begins_as(file: Path) -> bool:
    """Return whether a file begins as its suffix says."""
    try:
        with file.open("rb") as stream:
            return stream.read(16).startswith(_MAGIC[file.suffix])
    except OSError:
        return False


def chosen_topic(path: Path, reader: Any, topic: str | None) -> str:
    """Return the topic of clouds, the only one unless it is named."""
    clouds = sorted({c.topic for c in reader.connections if c.msgtype == CLOUD})
    known = ", ".join(clouds) or f"none; {_held(reader)}"
    if topic is not None:
        if topic not in clouds:
            hint = close_match(topic, clouds)
            raise RequestError(f"{path}: no PointCloud2 is on {topic!r}{hint}; topics: {known}")
        return topic
    if len(clouds) != 1:
        hint = "; --topic chooses one" if clouds else ""
        raise RequestError(f"{path}: the PointCloud2 of one topic is needed; topics: {known}{hint}")
    found: str = clouds[0]
    return found


def _held(reader: Any) -> str:
    """Return what topics a bag has."""
    kinds = {c.topic: c.msgtype.replace("/msg/", "/") for c in reader.connections}
    found = [f"{topic} ({kind})" for topic, kind in sorted(kinds.items())]
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return f"the bag has {', '.join(found[:_LISTED]) or 'no message'}{more}"


def _clouds(found: Points, number: int) -> list[Cloud]:
    """Return the points of a message, those of about one instant as one cloud."""
    if found.shifts is None or not len(found.shifts):
        return [Cloud(found.time, found.frame, found.points, number)]
    slices = np.round(found.shifts / _SLICE).astype(np.int64)
    return [
        Cloud(found.time + _SLICE * one, found.frame, found.points[slices == one], number)
        for one in np.unique(slices)
    ]


def times_of(path: Path, reader: Any, topic: str) -> PointTimes:
    """Return unit and zero of the times of the points on a topic, from its first clouds."""
    found = PointTimes()
    chosen = [c for c in reader.connections if c.topic == topic]
    for connection, received, data in reader.messages(connections=chosen):
        message = reader.deserialize(data, connection.msgtype)
        _, _, read = _read(f"{path}: {topic}", message)
        found.add(read.times, seconds(message.header.stamp), received * 1e-9)
        if found.complete:
            break
    return found


def read_points(where: str, message: Any, times: PointTimes) -> Points:
    """Return what a ``PointCloud2`` holds; ``times`` of its topic.

    Raises:
        RequestError: it has no stamp, no frame or no coordinates; the text begins with ``where``.
    """
    time, frame, found = _read(where, message)
    shifts = times.shifts(found.times, time)
    if shifts is None:
        return Points(time, frame, found.points, None)
    kept = np.isfinite(shifts)
    return Points(time, frame, found.points[kept], shifts[kept])


def _read(where: str, message: Any) -> tuple[float, str, Any]:
    time, frame = seconds(message.header.stamp), message.header.frame_id.lstrip("/")
    if time == 0:
        raise RequestError(
            f"{where}: a cloud has no stamp (header.stamp is 0), so that its pose is unknown; "
            "record the driver's messages, not those of a node that drops the header"
        )
    if not frame:
        raise RequestError(f"{where}: a cloud has no frame (header.frame_id is empty)")
    try:
        return time, frame, read_cloud(message)
    except ValueError as error:
        raise RequestError(f"{where}: {error}") from error


def _pose(place: Any, turn: Any) -> Pose | None:
    """Return a pose; None if it is none, as of a quaternion of zeros, which tf leaves out too."""
    found = np.array([place.x, place.y, place.z]), np.array([turn.x, turn.y, turn.z, turn.w])
    length = float(np.linalg.norm(found[1]))
    if not (np.isfinite(found[0]).all() and abs(length - 1) < _UNIT):
        return None
    return Pose(found[0], found[1] / length)


def seconds(stamp: Any) -> float:
    """Return a stamp as one number [s]."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


POSES = "poses.txt"
SUFFIXES = (".pcd", ".ply", ".xyz", ".npy")


def read_folder(folder: Path, but: Path | None = None) -> list[tuple[FloatArray, Pose]]:
    """Return the points of each cloud, (P, 3) [m], and the pose of its frame.

    ``but``: a file that is none of the clouds, although it may be in the folder.

    Raises:
        RequestError: there are no clouds, a file cannot be read, or the poses do not fit them.
        MissingExtraError: a PCD or PLY file needs a package that is not installed.
    """
    other = but and but.resolve()
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES]
    clouds = sorted((file for file in files if file.resolve() != other), key=_in_order)
    if not clouds:
        raise RequestError(
            f"{folder}: there are no clouds; files of {', '.join(SUFFIXES)} are read"
        )
    poses = _read_poses(folder / POSES)
    if len(poses) != len(clouds):
        raise RequestError(
            f"{folder / POSES}: {len(poses)} poses for {len(clouds)} clouds; one line for each "
            "cloud is needed, in the order of the files' names"
        )
    return [(_points(file), pose) for file, pose in zip(clouds, poses, strict=True)]


def _in_order(file: Path) -> list[tuple[str, int]]:
    """Return what orders names, with the numbers in them by value: ``2.pcd`` before ``10.pcd``."""
    parts = re.findall(r"(\D*)(\d*)", file.name)
    return [(text, int(digits or 0)) for text, digits in parts]


def read_stamps(folder: Path) -> FloatArray:
    """Return the stamps of the clouds, (C,) [s].

    Raises:
        RequestError: the poses cannot be read, or have no stamps.
    """
    rows = _read_rows(folder / POSES)
    if rows.shape[1] != 8:
        raise RequestError(
            f"{folder / POSES}: the clouds have no stamps; 8 numbers a line are needed (stamp, x, "
            f"y, z, qx, qy, qz, qw), the first line has {rows.shape[1]}"
        )
    return np.asarray(rows[:, 0], np.float64)


def _read_rows(file: Path) -> FloatArray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of numpy, on an empty file
            rows = np.loadtxt(file, ndmin=2)
    except OSError as error:
        raise RequestError(f"{file}: there is no such file; it holds the clouds' poses") from error
    except ValueError as error:
        raise RequestError(f"{file}: lines of numbers are allowed; {error}") from error
    if not rows.size:
        raise RequestError(f"{file}: it is empty; one line for each cloud is needed")
    finite = np.asarray(np.isfinite(rows).all(axis=1))
    _require(file, rows, finite, "finite numbers are allowed")
    return rows


def _require(file: Path, rows: FloatArray, fit: NDArray[np.bool_], allowed: str) -> None:
    """Raise RequestError, naming the first of the ``rows`` that is not ``fit``, (L,) both."""
    for number, (row, ok) in enumerate(zip(rows.tolist(), fit, strict=True), 1):
        if not ok:
            numbers = " ".join(f"{value:g}" for value in row)
            raise RequestError(f"{file}, pose {number}: {allowed}; it is {numbers}")


def _read_poses(file: Path) -> list[Pose]:
    from scipy.spatial.transform import Rotation

    rows = _read_rows(file)
    if rows.shape[1] == 8:
        turned = np.linalg.norm(rows[:, 4:], axis=1) > 0
        _require(file, rows, turned, "the quaternion (its last four numbers) must not be 0")
        return [Pose(row[1:4], row[4:] / np.linalg.norm(row[4:])) for row in rows]
    if rows.shape[1] == 12:
        matrices = rows.reshape(-1, 3, 4)
        turns = Rotation.from_matrix(matrices[:, :, :3]).as_quat()
        return [Pose(matrix[:, 3], turn) for matrix, turn in zip(matrices, turns, strict=True)]
    raise RequestError(
        f"{file}: 8 numbers (stamp, x, y, z, qx, qy, qz, qw) or 12 (the rows of [R|t]) a line are "
        f"allowed; the first line has {rows.shape[1]}"
    )


def _points(file: Path) -> FloatArray:
    suffix = file.suffix.lower()
    try:
        if suffix == ".npy":
            points = np.load(file, allow_pickle=False)
        elif suffix == ".xyz":
            points = np.loadtxt(file, usecols=(0, 1, 2), ndmin=2)
        elif suffix == ".pcd":
            from pypcd4.pypcd4 import PointCloud

            points = PointCloud.from_path(file).numpy(("x", "y", "z"))
        else:
            import trimesh

            points = trimesh.load(file).vertices  # type: ignore[attr-defined]  # of a cloud
    except ImportError as error:
        raise MissingExtraError(
            f"{file}: {error.name} is not installed; run pip install 'flipperctl[profiles]'"
        ) from error
    except Exception as error:  # each library has its own errors for damaged files
        text = " ".join(str(error).split())
        raise RequestError(f"{file} cannot be read: {type(error).__name__}: {text}") from error
    found = np.asarray(points, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] < 3:
        raise RequestError(
            f"{file}: an array of points (P, 3) is allowed; its shape is {found.shape}"
        )
    found = found[:, :3]
    return found[np.isfinite(found).all(axis=1)]
