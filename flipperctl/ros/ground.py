"""Recorded ground from what a robot has measured: clouds with poses → one cloud and a line.

In: a bag, or a folder of clouds with poses. Out: the points of the ground in one frame without
those of the robot, thinned, as an ``.xyz`` file that ``terrain=profile_file`` reads, and the line
that the robot drove.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Robot
from flipperctl.errors import RequestError
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.ros.reading import (
    POSES,
    Points,
    Scans,
    chosen_topic,
    messages,
    opened,
    read_folder,
    read_points,
    read_transforms,
    times_of,
)
from flipperctl.ros.topics import Names

_HEADER = "# ground by flipperctl: x y z [m]\n"
"""First line of each file, by which an earlier one is recognised."""
GROUND = OutputKind("recorded ground", (".xyz",), re.compile(rb"\A# ground by flipperctl"))
HALF_WIDTH = 0.45
"""Points closer than this to the middle of the robot, within its length, are its own [m]."""
_MARGIN = 0.05  # around the length of the robot [m]
_SHORTEST = 0.5
"""Shortest line that can be driven over [m]."""
_SLICE, _GAP = 0.1, 0.15
"""Width of the strip that ``profile_file`` reads, and largest gap in it, which it bridges [m]."""
_INSET = 0.02
"""Distance of the line's ends from the last points [m]."""


_USUAL = Names()
_PART = 0.01
"""Points of a turning LiDAR are taken for simultaneous within this time [s]."""


def convert(
    source: Path,
    output: Path,
    robot: Robot,
    names: Names = _USUAL,
    reach: float = 5.0,
    cell: float = 0.02,
) -> dict[str, Any]:
    """Write the ground of a bag or folder to an ``.xyz`` file; return what it covers.

    ``reach``: largest distance of a point from the chassis [m]; ``cell``: edge of a cube of which
    the mean of the points is kept [m].

    Raises:
        MissingExtraError: rosbags, or a package for the clouds' format, is not installed.
        RequestError: the source cannot be read, or the robot hardly moved.
        OutputError: the file cannot be written, see ``check_output``.
    """
    check_output(output, GROUND)
    if source.is_dir() and (source / POSES).exists():
        scans, _ = read_folder(source, output)
        sizes, skipped, remarks = [len(points) for points, _ in scans], 0, list[str]()
    else:
        scans, sizes, skipped, remarks = _scans(source, names)
    points = thinned(_seen(scans, robot, reach, cell), cell)
    start, end = _known_line(source, points, scans, _half_length(robot))
    rows = (f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points.tolist())
    write_bytes(output, (_HEADER + "".join(rows)).encode())
    return {
        "source": str(source),
        "output": str(output),
        "clouds": len(sizes),
        "clouds_without_pose": skipped,
        "points_per_cloud": {
            "least": min(sizes),
            "median": round(float(np.median(sizes))),
            "most": max(sizes),
        },
        "points": len(points),
        "start": [round(float(number), 3) + 0.0 for number in start],
        "end": [round(float(number), 3) + 0.0 for number in end],
        "length": float(np.linalg.norm(end - start)),
        "remarks": remarks,
    }


def _known_line(
    source: Path, points: FloatArray, scans: Scans, ahead: float
) -> tuple[FloatArray, FloatArray]:
    """Return the ends, (2,) each [m], of the longest part of the robot's way whose ground was seen.

    The way is the straight line from its first to its last place, and as far ``ahead`` as the robot
    reaches. The ground below the robot at the start is never seen.
    """
    first, last = scans[0][1].place[:2], scans[-1][1].place[:2]
    length = float(np.linalg.norm(last - first))
    if length < _SHORTEST:
        raise RequestError(
            f"{source}: the robot is {length:.2f} m from its start at the end; at least "
            f"{_SHORTEST} m is needed for a line over the ground"
        )
    direction = (last - first) / length
    offset = points[:, :2] - first
    beside = offset @ np.array([-direction[1], direction[0]])
    along = np.sort((offset @ direction)[np.abs(beside) <= _SLICE / 2])
    along = along[(along >= 0) & (along <= length + ahead)]
    parts = np.split(along, np.flatnonzero(np.diff(along) > _GAP) + 1)
    longest = max(parts, key=lambda part: float(np.ptp(part)) if len(part) else 0.0)
    if not len(longest) or np.ptp(longest) < _SHORTEST:
        raise RequestError(
            f"{source}: the clouds show no {_SHORTEST} m of ground in a row along the robot's way; "
            "are the frames of the chassis and of the sensor right?"
        )
    return first + direction * (longest[0] + _INSET), first + direction * (longest[-1] - _INSET)


def _scans(source: Path, names: Names) -> tuple[Scans, list[int], int, list[str]]:
    """Return the clouds of a bag in the frame of the chassis, and what became of its messages.

    That is the number of points of each that is used, the number of those without a pose, and what
    a reader of the result should know.
    """
    scans, sizes, count, points = [], Counter[int](), 0, 0
    with opened(source) as reader:
        topic = chosen_topic(source, reader, names.clouds)
        transforms, times = read_transforms(source, reader), times_of(source, reader, topic)
        for number, (*_, message) in enumerate(messages(reader, [topic])):
            count = number + 1
            for part in _parts(read_points(f"{source}: {topic}", message, times)):
                points += len(part.points)
                pose = transforms.pose(names.fixed, names.base, part.time)
                mount = transforms.pose(names.base, part.frame, part.time)
                if pose is not None and mount is not None:
                    sizes[number] += len(part.points)
                    scans.append((mount.apply(part.points), pose))
    if not points:
        raise RequestError(f"{source}: the {count} clouds of {topic} have no points")
    if not scans:
        raise RequestError(
            f"{source}: none of the {count} clouds of {topic} has a transform to "
            f"{names.fixed!r} at its stamp; is another clock in the stamps?"
        )
    remarks = [f"{topic}: {remark}" for remark in times.remarks()]
    remarks += transforms.remarks(names.fixed, names.base)
    return scans, [*sizes.values()], count - len(sizes), remarks


def _parts(cloud: Points) -> Iterator[Points]:
    """Yield the points of a message, those of about one instant together."""
    if cloud.shifts is None or not len(cloud.shifts):
        yield cloud
        return
    parts = np.round(cloud.shifts / _PART).astype(np.int64)
    for one in np.unique(parts):
        yield Points(cloud.time + _PART * one, cloud.frame, cloud.points[parts == one])


def _half_length(robot: Robot) -> float:
    """Return the distance from the chassis centre to the tip of a level flipper, and more [m]."""
    return robot.hinge_offset + robot.flipper_axle + robot.track_radius + _MARGIN


def _seen(scans: Scans, robot: Robot, reach: float, cell: float) -> FloatArray:
    """Return the points of all scans in the fixed frame, without the robot's own."""
    ahead = _half_length(robot)

    parts = [np.empty((0, 3))]
    for points, pose in scans:
        x, y, _ = points.T
        own = (np.abs(x) <= ahead) & (np.abs(y) <= HALF_WIDTH)
        near = np.linalg.norm(points, axis=1) <= reach
        parts.append(thinned(pose.apply(points[near & ~own]), cell))
    return np.concatenate(parts)


def thinned(points: FloatArray, cell: float) -> FloatArray:
    """Return the mean of the points in each cube of edge ``cell`` [m], (C, 3), sorted by cube."""
    if not len(points):
        return points
    cubes = np.floor(points / cell).astype(np.int64)
    _, group = np.unique(cubes, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    return np.column_stack([np.bincount(group, weights=axis) / count for axis in points.T])
