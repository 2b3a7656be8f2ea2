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
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from flipperctl.api import FloatArray
from flipperctl.errors import MissingExtraError, RequestError
from flipperctl.messages import close_match
from flipperctl.ros.messages import require_rosbags, typestore
from flipperctl.ros.transforms import Pose, Transforms
from flipperctl.runtime.point_cloud import PointTimes, read_cloud

CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
_FRAMES = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_STATIC = "tf_static"
_METADATA = "metadata.yaml"
_FILES = {
    ".mcap": (b"\x89MCAP", "'mcap recover {} -o whole.mcap'"),
    ".db3": (b"SQLite format 3", "'ros2 bag reindex' on its folder"),
    ".bag": (b"#ROSBAG", "'rosbag reindex {}'"),
}
"""Suffix of a bag's file → its first bytes, and what mends one."""
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
class Points:
    """The points of one message, or of a part of it."""

    time: float
    """Their stamp [s]."""
    frame: str
    points: FloatArray
    """(P, 3) finite points in that frame [m]."""
    shifts: FloatArray | None = None
    """(P,) time of each point after the stamp, negative before it [s]; None: they have none."""


def messages(
    reader: Any, topics: Collection[str] = (), kinds: Collection[str] = ()
) -> Iterator[tuple[str, float, Any]]:
    """Yield topic, time of recording [s] and message, of these topics and of these types."""
    chosen = [c for c in reader.connections if c.topic in topics or c.msgtype in kinds]
    # Without a connection, rosbags would yield the messages of all.
    for connection, stamp, data in reader.messages(connections=chosen) if chosen else ():
        yield connection.topic, stamp * 1e-9, reader.deserialize(data, connection.msgtype)


def read_transforms(path: Path, reader: Any) -> Transforms:
    """Return all transforms of a bag; those of ``tf_static`` are fixed.

    The pose of an odometry is a transform as well, for a frame that has no other.

    Raises:
        RequestError: several topics tell the pose of one frame, and no transform does.
    """
    transforms, odometry = Transforms(path), list[tuple[str, Any]]()
    for topic, _, message in messages(reader, kinds=(*_FRAMES, ODOMETRY)):
        if hasattr(message, "pose"):
            odometry.append((topic, message))
            continue
        static = topic.rstrip("/").endswith(_STATIC)
        for one in message.transforms:
            time = None if static else seconds(one.header.stamp)
            pose = _pose(one.transform.translation, one.transform.rotation)
            if pose is not None:
                transforms.add(one.header.frame_id, one.child_frame_id, time, pose)
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
    for _, one in odometry:
        if one.child_frame_id.lstrip("/") in topics:
            pose = _pose(one.pose.pose.position, one.pose.pose.orientation)
            if pose is not None:
                parent, time = one.header.frame_id, seconds(one.header.stamp)
                transforms.add(parent, one.child_frame_id, time, pose)
    return transforms


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a bag; an error of its content names the file.

    Raises:
        MissingExtraError: rosbags is not installed.
        RequestError: the file is no bag.
    """
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
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        begins, tool = _FILES.get(file.suffix, (b"", ""))
        if not tool or not file.is_file():
            continue
        with suppress(OSError), file.open("rb") as stream:
            if stream.read(16).startswith(begins):
                return f"; if the recording was cut off, {tool.format(file)} mends it"
    return ""


def chosen_topic(path: Path, reader: Any, topic: str | None) -> str:
    """Return the topic of clouds, the only one unless it is named.

    Raises:
        RequestError: there is no such topic, or none or several have clouds.
    """
    kinds = {c.topic: c.msgtype for c in reader.connections}
    clouds = sorted(name for name, kind in kinds.items() if kind == CLOUD)
    has = [f"{name} ({kind.replace('/msg/', '/')})" for name, kind in sorted(kinds.items())]
    more = f" and {len(has) - _LISTED} more" if len(has) > _LISTED else ""
    held = f"none; the bag has {', '.join(has[:_LISTED]) or 'no message'}{more}"
    known = ", ".join(clouds) or held
    if topic is not None and topic not in clouds:
        hint = close_match(topic, clouds)
        raise RequestError(f"{path}: no PointCloud2 is on {topic!r}{hint}; topics: {known}")
    if topic is None and len(clouds) != 1:
        hint = "; --topic chooses one" if clouds else ""
        raise RequestError(f"{path}: the PointCloud2 of one topic is needed; topics: {known}{hint}")
    return topic or clouds[0]


def times_of(path: Path, reader: Any, topic: str) -> PointTimes:
    """Return unit and zero of the times of the points on a topic, from its first clouds."""
    times = PointTimes()
    for _, received, message in messages(reader, [topic]):
        time, _, cloud = _read(f"{path}: {topic}", message)
        times.add(cloud.times, time, received)
        if times.complete:
            break
    return times


def read_points(where: str, message: Any, times: PointTimes) -> Points:
    """Return what a ``PointCloud2`` holds; ``times`` of its topic.

    Raises:
        RequestError: it has no stamp, no frame or no coordinates; the text begins with ``where``.
    """
    time, frame, cloud = _read(where, message)
    shifts = times.shifts(cloud.times, time)
    if shifts is None:
        return Points(time, frame, cloud.points)
    kept = np.isfinite(shifts)
    return Points(time, frame, cloud.points[kept], shifts[kept])


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
    origin, quaternion = np.array([place.x, place.y, place.z]), [turn.x, turn.y, turn.z, turn.w]
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(origin).all() and abs(length - 1) < _UNIT):
        return None
    return Pose(origin, np.array(quaternion) / length)


def seconds(stamp: Any) -> float:
    """Return a stamp as one number [s]."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


POSES = "poses.txt"
SUFFIXES = (".pcd", ".ply", ".xyz", ".npy")
Scans = list[tuple[FloatArray, Pose]]
"""Points in the frame of the chassis, (P, 3) [m], and the chassis in the fixed frame."""


def read_folder(folder: Path, but: Path | None = None) -> tuple[Scans, FloatArray | None]:
    """Return the clouds with their poses, and their stamps, (C,) [s], if the poses have any.

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
    poses, stamps = _read_poses(folder / POSES)
    if len(poses) != len(clouds):
        raise RequestError(
            f"{folder / POSES}: {len(poses)} poses for {len(clouds)} clouds; one line for each "
            "cloud is needed, in the order of the files' names"
        )
    return [(_points(file), pose) for file, pose in zip(clouds, poses, strict=True)], stamps


def _in_order(file: Path) -> list[tuple[str, int]]:
    """Return what orders names, with the numbers in them by value: ``2.pcd`` before ``10.pcd``."""
    parts = re.findall(r"(\D*)(\d*)", file.name)
    return [(text, int(digits or 0)) for text, digits in parts]


def _read_poses(file: Path) -> tuple[list[Pose], FloatArray | None]:
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
    if rows.shape[1] == 8:
        length = np.linalg.norm(rows[:, 4:], axis=1)
        _require(file, rows, length > 0, "the quaternion (its last four numbers) must not be 0")
        turns = rows[:, 4:] / length[:, None]
        return [Pose(row[1:4], turn) for row, turn in zip(rows, turns, strict=True)], rows[:, 0]
    if rows.shape[1] == 12:
        matrices = rows.reshape(-1, 3, 4)
        try:
            turns = Rotation.from_matrix(matrices[:, :, :3]).as_quat()
        except ValueError as error:
            raise RequestError(f"{file}: [R|t] needs a rotation R; {error}") from error
        return [Pose(m[:, 3], turn) for m, turn in zip(matrices, turns, strict=True)], None
    raise RequestError(
        f"{file}: 8 numbers (stamp, x, y, z, qx, qy, qz, qw) or 12 (the rows of [R|t]) a line are "
        f"allowed; the first line has {rows.shape[1]}"
    )


def _require(file: Path, rows: FloatArray, fit: NDArray[np.bool_], allowed: str) -> None:
    """Raise RequestError, naming the first of the ``rows`` that is not ``fit``, (L,) both."""
    for number in np.flatnonzero(~fit)[:1].tolist():
        numbers = " ".join(f"{value:g}" for value in rows[number])
        raise RequestError(f"{file}, pose {number + 1}: {allowed}; it is {numbers}")


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
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] < 3:
        raise RequestError(
            f"{file}: an array of points (P, 3) is allowed; its shape is {array.shape}"
        )
    array = array[:, :3]
    return array[np.isfinite(array).all(axis=1)]
