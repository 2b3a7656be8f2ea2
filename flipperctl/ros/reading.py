"""What a bag holds: point clouds, and where frames are in each other over time.

In: a bag of ROS 1 or ROS 2, such as a folder of ``ros2 bag record``, an ``.mcap`` or a ``.bag``.
Out: its messages; points with their stamps and frames; and in numpy what tf2 answers. That is the
pose of a frame in another at a time, interpolated between the transforms that were recorded.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flipperctl.api import FloatArray
from flipperctl.core.crosschecks import Difference, Peak, by_clock, by_steps, compared
from flipperctl.core.lidar.messages import Pose as ChassisPose
from flipperctl.errors import RequestError
from flipperctl.ros.messages import require_rosbags
from flipperctl.runtime.point_cloud import PointTimes, read_cloud
from flipperctl.text.messages import close_match

CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
_FRAMES = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
_STATIC = "tf_static"
_UNIT = 0.05
"""Most by which the length of a quaternion may differ from 1 [-]."""
FARTHEST = 0.25
"""Longest time to the nearest transform [s]."""


@dataclass(frozen=True)
class Pose:
    """A frame in another."""

    place: FloatArray
    """Its origin, (3,) [m]."""
    turn: FloatArray
    """Rotation from it to the other frame, as x, y, z and w, (4,) [-]."""

    @classmethod
    def none(cls) -> Pose:
        """Return the pose of a frame in itself."""
        return cls(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    def apply(self, points: FloatArray) -> FloatArray:
        """Return points of the frame, (P, 3), in the other frame [m]."""
        return self.directions(points) + self.place

    def directions(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the frame, (P, 3), along the axes of the other frame."""
        turned: FloatArray = Rotation.from_quat(self.turn).apply(vectors)
        return turned

    def after(self, inner: Pose) -> Pose:
        """Return the pose of ``inner``'s frame, which is a pose in this one, in the other frame."""
        both = Rotation.from_quat(self.turn) * Rotation.from_quat(inner.turn)
        return Pose(self.apply(inner.place[None])[0], both.as_quat())

    def near(self, other: Pose) -> bool:
        """Return whether another pose is the same within a millimetre and a thousandth."""
        turned = 1 - abs(float(self.turn @ other.turn))  # of unit quaternions: 1 - cos(angle / 2)
        return bool(np.linalg.norm(self.place - other.place) <= 1e-3 and turned <= 1e-6)

    def inverse(self) -> Pose:
        """Return the pose of the other frame in this one."""
        back = Rotation.from_quat(self.turn).inv()
        return Pose(-back.apply(self.place), back.as_quat())


def estimated(pose: Pose) -> ChassisPose:
    """Return the chassis in a fixed frame as the estimator takes it."""
    turn = Rotation.from_quat(pose.turn).as_matrix()
    x, y, z = pose.place.tolist()
    forward, left = turn[:, 0].tolist(), turn[:, 1].tolist()
    roll, pitch = (math.asin(min(1.0, max(-1.0, axis[2]))) for axis in (left, forward))
    return ChassisPose(x, y, z, roll, pitch, math.atan2(forward[1], forward[0]))


class _Track:
    """The poses of a frame in its parent, by time."""

    def __init__(self) -> None:
        self.fixed: list[Pose] = []
        self._heard: list[tuple[float, float, Pose]] = []  # time, time of receipt, pose

    def add(self, time: float | None, received: float, pose: Pose) -> None:
        """Add a pose at a time [s]; None if it is fixed."""
        if time is None:
            self.fixed.append(pose)
        else:
            self._heard.append((time, received, pose))
            self.__dict__.pop("_sorted", None)

    @cached_property
    def _sorted(self) -> tuple[list[float], list[Pose], bool]:
        """Times and poses in their order, and whether several poses are all the same."""
        heard = sorted(self._heard, key=lambda row: row[0])
        poses = [pose for *_, pose in heard]
        still = len(poses) > 1 and all(poses[0].near(pose) for pose in poses)
        return [time for time, *_ in heard], poses, still

    def at(self, time: float) -> Pose | None:
        """Return the pose at a time; None if the nearest one is too far away.

        One that is the same before and after a time is that of the time, however far these are.
        """
        if self.fixed:
            return self.fixed[-1]

        # A recorded pose, if there is one at this very time
        times, poses, still = self._sorted
        after = bisect_right(times, time)
        if after and times[after - 1] == time:
            return poses[after - 1]
        first, last = max(0, after - 1), min(after, len(times) - 1)
        nearest = min(first, last, key=lambda i: abs(times[i] - time))

        # Otherwise between the poses before and after, where they are near enough
        inside = first != last
        same = still or (inside and poses[first].near(poses[last]))
        if abs(times[nearest] - time) > FARTHEST and not same:
            return None
        if not inside:
            return poses[nearest]
        part = (time - times[first]) / (times[last] - times[first])
        begin, end = poses[first], poses[last]
        # Of the two quaternions of a rotation, the one on the side of the first.
        near = end.turn if begin.turn @ end.turn >= 0 else -end.turn
        turn = (1 - part) * begin.turn + part * near
        place = (1 - part) * begin.place + part * end.place
        return Pose(place, turn / np.linalg.norm(turn))

    def checked(self, link: str) -> tuple[list[Difference], float | None]:
        """Return what its poses and stamps contradict, and their delay [s], if they have any."""
        # A fixed link must not change; another one must not jump.
        heard = [*self.fixed, *(pose for *_, pose in self._heard)]
        places, turns = np.array([p.place for p in heard]), np.array([p.turn for p in heard])
        if self.fixed:  # all poses that it has must be the same
            sizes = by_steps(np.zeros(len(heard)), places, turns).values()
            static = Peak(max((peak.size for peak in sizes if peak), default=0.0))
            return compared(link, transforms_static=static), None
        times, received, _ = map(np.array, zip(*self._heard, strict=True))
        stamps, delay = by_clock(received, times)
        return compared(link, **by_steps(times, places, turns), **stamps), delay


_Link = tuple[str, str]
"""A frame and one of its parents."""


class Transforms:
    """A tree of frames, or several that share a frame: a frame may have several parents."""

    def __init__(self, source: Path | None = None) -> None:
        """``source``: the recording, for errors."""
        self._where = "" if source is None else f"{source}: "
        self._tracks: dict[str, dict[str, _Track]] = {}  # child → parent → its poses
        self._known: dict[_Link, list[tuple[list[_Link], list[_Link]]]] = {}

    def add(
        self, parent: str, child: str, time: float | None, pose: Pose, received: float = 0.0
    ) -> None:
        """Add the pose of ``child`` in ``parent`` at a time [s]; None if it is fixed."""
        tracks = self._tracks.setdefault(child.lstrip("/"), {})
        if parent.lstrip("/") not in tracks:
            self._known.clear()
        tracks.setdefault(parent.lstrip("/"), _Track()).add(time, received, pose)

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        return sorted({*self._tracks}.union(*self._tracks.values()))

    def has(self, child: str) -> bool:
        """Return whether the pose of a frame in a parent is known."""
        return child.lstrip("/") in self._tracks

    def remarks(self, fixed: str, base: str) -> list[str]:
        """Return what a reader of the poses of ``base`` in ``fixed`` should know."""
        parents = sorted(self._tracks.get(base, ()))
        remark = (
            f"{base} has {len(parents)} parents, {' and '.join(parents)}: its poses are those in "
            f"{fixed} (--fixed-frame)"
        )
        return [remark] if len(parents) > 1 else []

    def pose(self, frame: str, of: str, time: float) -> Pose | None:
        """Return the pose of the frame ``of`` in ``frame``; None if it is unknown at that time.

        Of several parents, the one counts that leads to ``frame``; two ways must not differ.
        A frame needs no transform to itself.
        """
        frame, of = frame.lstrip("/"), of.lstrip("/")
        results: list[tuple[list[_Link], Pose]] = []
        if not (ways := self._ways(frame, of)):
            for name in (frame, of):
                if name not in self.frames:
                    hint, known = close_match(name, self.frames), ", ".join(self.frames) or "none"
                    raise RequestError(
                        f"{self._where}there is no frame {name!r}{hint}; frames with a transform: "
                        f"{known}"
                    )
            raise RequestError(f"{self._where}nothing connects the frames {frame!r} and {of!r}")

        # Every way must tell the same; the first one counts.
        for up, down in ways:
            frame_in_top, other_in_top = self._along(down, time), self._along(up, time)
            if frame_in_top is not None and other_in_top is not None:
                results.append(([*up, *down], frame_in_top.inverse().after(other_in_top)))
        for way, pose in results[1:]:
            if not results[0][1].near(pose):
                first_way = results[0][0]
                child, first = next(link for link in first_way if link not in way)
                second = next((parent for name, parent in way if name == child), way[0][1])
                raise RequestError(
                    f"{self._where}{child!r} has two parents, {first!r} and {second!r}, by which "
                    f"the poses of {of!r} in {frame!r} differ; a recording with one of them is "
                    "needed"
                )
        return results[0][1] if results else None

    def checked(self, frame: str, of: str) -> tuple[list[Difference], list[float]]:
        """Return what the links between two frames contradict, and their delays [s]."""
        links = dict.fromkeys(
            link for way in self._ways(frame, of) for part in way for link in part
        )
        results = [self._tracks[c][p].checked(f"transform {p} → {c}") for c, p in links]
        differences = [difference for part, _ in results for difference in part]
        return differences, [delay for _, delay in results if delay is not None]

    def _ways(self, frame: str, of: str) -> list[tuple[list[_Link], list[_Link]]]:
        """Return the links from ``of`` up to a frame above both, and from ``frame`` up to it.

        Ways that only climb, or only descend, come before those that do both.
        """
        if (frame, of) not in self._known:
            ways = []
            # Up to a common frame and down again, without a frame twice
            above = list(self._above(frame))
            for up in self._above(of):
                passed = {of, *(parent for _, parent in up)}
                for down in above:
                    top = down[-1][1] if down else frame
                    others = {frame, *(parent for _, parent in down)} - {top}
                    if top == (up[-1][1] if up else of) and not others & passed:
                        ways.append((up, down))
            straight = [way for way in ways if not (way[0] and way[1])]
            self._known[frame, of] = straight or ways
        return self._known[frame, of]

    def _above(self, frame: str, passed: tuple[_Link, ...] = ()) -> Iterator[list[_Link]]:
        """Yield the links to each frame above a frame, on each way, and none to itself."""
        yield list(passed)
        for parent in sorted(self._tracks.get(frame, ())):
            if parent not in {frame, *(child for child, _ in passed)}:
                yield from self._above(parent, (*passed, (frame, parent)))

    def _along(self, links: list[_Link], time: float) -> Pose | None:
        """Return the pose of the first frame of a chain of links in the last one."""
        total = Pose.none()
        for child, parent in links:
            if (pose := self._tracks[child][parent].at(time)) is None:
                return None
            total = pose.after(total)
        return total


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
    connections = [c for c in reader.connections if c.topic in topics or c.msgtype in kinds]
    for connection, stamp, data in reader.messages(connections):
        yield connection.topic, stamp * 1e-9, reader.deserialize(data, connection.msgtype)


def read_transforms(path: Path, reader: Any) -> Transforms:
    """Return all transforms of a bag; transforms of ``tf_static`` are fixed.

    The pose of an odometry is a transform as well, for a frame that has no other.
    """
    # Poses of odometry wait, since a transform of the same frame goes before them.
    transforms, odometry = Transforms(path), list[tuple[str, float, Any]]()
    for topic, received, message in messages(reader, kinds=(*_FRAMES, ODOMETRY)):
        if hasattr(message, "pose"):
            odometry.append((topic, received, message))
            continue
        static = topic.rstrip("/").endswith(_STATIC)
        for transform in message.transforms:
            time = None if static else seconds(transform.header.stamp)
            pose = pose_of(transform.transform.translation, transform.transform.rotation)
            if pose is not None:
                transforms.add(
                    transform.header.frame_id, transform.child_frame_id, time, pose, received
                )

    # Odometry, one source for each frame
    known = {frame for frame in transforms.frames if transforms.has(frame)}
    sources: dict[str, str] = {}  # frame → topic of its odometry
    for topic, received, message in odometry:
        if (frame := message.child_frame_id.lstrip("/")) in known:
            continue
        if (first := sources.setdefault(frame, topic)) != topic:
            raise RequestError(
                f"{path}: the poses of {frame!r} come from {' and '.join(sorted((first, topic)))}, "
                "and from no transform; a bag with one of them, or with tf, is allowed"
            )
        pose = pose_of(message.pose.pose.position, message.pose.pose.orientation)
        if pose is not None:
            transforms.add(
                message.header.frame_id, frame, seconds(message.header.stamp), pose, received
            )
    return transforms


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a bag; an error of its content names the file."""
    require_rosbags("reading a bag")
    from flipperctl.ros.storage import METADATA, STORAGES, Bag

    if not path.exists():
        raise RequestError(f"{path}: there is no such file or folder")
    if path.is_dir() and not (path / METADATA).exists():
        inside = sorted(file.name for file in path.iterdir() if file.suffix in STORAGES)
        hint = f"; {' and '.join(inside[:3])} in it can be given itself" if inside else ""
        raise RequestError(
            f"{path}: this folder has neither {METADATA}, as a bag of ROS 2, nor poses.txt, as a "
            f"folder of clouds{hint}"
        )
    with ExitStack() as stack:
        yield Bag(path, stack)


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
    """Return what a ``PointCloud2`` holds; ``times`` of its topic; ``where`` begins errors."""
    time, frame, cloud = _read(where, message)
    # Without the time of a point, the place of a moving LiDAR is unknown.
    shifts = times.shifts(cloud.times, time)
    if shifts is None:
        return Points(time, frame, cloud.points)
    timed = np.isfinite(shifts)
    return Points(time, frame, cloud.points[timed], shifts[timed])


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


def pose_of(place: Any, turn: Any) -> Pose | None:
    """Return a pose; None if it is none, as of a quaternion of zeros, which tf leaves out too."""
    origin, quaternion = np.array([place.x, place.y, place.z]), [turn.x, turn.y, turn.z, turn.w]
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(origin).all() and abs(length - 1) < _UNIT):
        return None
    return Pose(origin, np.array(quaternion) / length)


def seconds(stamp: Any) -> float:
    """Return a stamp as one number [s]."""
    return float(stamp.sec + stamp.nanosec * 1e-9)
