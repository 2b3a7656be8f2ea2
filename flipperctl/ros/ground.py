"""Recorded ground from what a robot has measured: clouds with poses → one cloud and a line.

In: a bag; or a folder of clouds with ``poses.txt``, one line for each of them in the order of their
names, 2 before 10. A line has 8 numbers as TUM's tools write them: stamp, place and quaternion (x y
z qx qy qz qw). Or it has 12 as KITTI's do: the upper rows of the matrix. Out: the points of the
ground in one frame without the robot's own, thinned, as an ``.xyz`` file that
``terrain=profile_file`` reads, and the line that the robot drove.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from flipperctl.api import FloatArray, Robot
from flipperctl.errors import RequestError, missing_extra
from flipperctl.ros.reading import Points, Pose, messages, opened, read_points
from flipperctl.ros.recording import Recording, read_recording
from flipperctl.ros.topics import Names
from flipperctl.text.files import OutputKind, check_output, write_bytes
from flipperctl.text.messages import counted

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
_STEP, _MOST_STEPS, _STRAY = 0.05, 300, 0.3
"""Distance between the places of a way, their largest number, and how far a straight one strays
[m, -, m]."""
_INSET = 0.02
"""Distance of the line's ends from the last points [m]."""
POSES = "poses.txt"
SUFFIXES = (".pcd", ".ply", ".xyz", ".npy")
Scans = list[tuple[FloatArray, Pose]]
"""Points in the frame of the chassis, (P, 3) [m], and the chassis in the fixed frame."""
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

    ``reach``: largest distance of a point from the chassis [m]; ``cell``: edge of a cube, whose
    points are replaced by their mean [m].
    """
    # Clouds in the frame of the chassis with its poses, from whichever source
    check_output(output, GROUND)
    if source.is_dir() and (source / POSES).exists():
        scans, _ = read_folder(source, output)
        sizes, skipped = [len(points) for points, _ in scans], 0
        remarks, checks = list[str](), list[dict[str, Any]]()
    else:
        scans, sizes, skipped, recording = _scans(source, names)
        remarks, checks = recording.remarks, recording.checked.rows

    # The ground without the robot, and where it drove straight on over it
    ahead = robot.reach + _MARGIN
    points = _thinned(_seen(scans, ahead, reach, cell), cell)
    line = _known_line(source, points, scans, ahead)
    if line is None:
        remarks.append(
            f"the robot nowhere drove {_SHORTEST} m straight on, so that no line is proposed: set "
            "terrain.start and terrain.end"
        )

    # Plain text, which every tool for clouds reads
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
        **_ends(line),
        "checks": checks,
        "remarks": remarks,
    }


def _ends(line: tuple[FloatArray, FloatArray] | None) -> dict[str, Any]:
    """Return a line as plain data, with None for everything if there is none."""
    if line is None:
        return dict.fromkeys(("start", "end", "length"))
    start, end = ([round(float(number), 3) + 0.0 for number in place] for place in line)
    return {"start": start, "end": end, "length": float(np.linalg.norm(line[1] - line[0]))}


def _known_line(
    source: Path, points: FloatArray, scans: Scans, ahead: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the ends, (2,) each [m], of the longest part of the robot's way whose ground was seen.

    The way is the longest part that was nearly straight, and as far ``ahead`` as the robot reaches.
    The ground below the robot at the start is never seen. None: it never drove straight on.
    """
    # Distances along the way and beside it
    first, last = _straightest(np.array([pose.place[:2] for _, pose in scans]))
    length = float(np.linalg.norm(last - first))
    if length < _SHORTEST:
        return None
    direction = (last - first) / length
    offset = points[:, :2] - first
    across = offset @ np.array([-direction[1], direction[0]])
    along = np.sort((offset @ direction)[np.abs(across) <= _SLICE / 2])
    along = along[(along >= 0) & (along <= length + ahead)]

    # The strip in one piece, up to gaps that the terrain bridges
    parts = np.split(along, np.flatnonzero(np.diff(along) > _GAP) + 1)
    longest = max(parts, key=lambda part: float(np.ptp(part)) if len(part) else 0.0)
    if not len(longest) or np.ptp(longest) < _SHORTEST:
        raise RequestError(
            f"{source}: the clouds show no {_SHORTEST} m of ground in a row along the robot's way; "
            "are the frames of the chassis and of the sensor right?"
        )
    return first + direction * (longest[0] + _INSET), first + direction * (longest[-1] - _INSET)


def _straightest(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the longest nearly straight part of a way, (N, 2) [m]."""
    # Places at equal distances, so few that all pairs can be tried
    steps = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    spacing = max(_STEP, steps[-1] / _MOST_STEPS)
    _, thinned = np.unique(np.floor(steps / spacing), return_index=True)
    way = places[np.unique(np.append(thinned, len(places) - 1))]

    # The farthest place from each one first: the first way that is straight is its longest.
    best = way[0], way[0]
    for i in range(len(way)):
        lengths = np.linalg.norm(way - way[i], axis=1)
        longer = lengths > np.linalg.norm(best[1] - best[0]) + spacing
        for j in (k for k in np.argsort(-lengths) if k > i and longer[k]):
            x, y = (way[j] - way[i]) / lengths[j]
            if np.abs((way[i:j] - way[i]) @ (-y, x)).max() <= _STRAY:
                best = way[i], way[j]
                break
    return best


def _scans(source: Path, names: Names) -> tuple[Scans, list[int], int, Recording]:
    """Return the clouds of a bag in the frame of the chassis, and what became of its messages.

    That is the number of points of each that is used, and the number of those without a pose.
    """
    scans, sizes, count, points = [], Counter[int](), 0, 0
    # Each point is placed by the poses at its own time, since the robot moves while a LiDAR turns.
    recording = read_recording(source, names, motion=False)
    transforms, repeated = recording.transforms, recording.checked.repeated
    topic = recording.used.clouds
    with opened(source) as reader:
        for number, (*_, message) in enumerate(messages(reader, [topic])):
            count = number + 1
            if number in repeated:
                continue
            for part in _parts(read_points(f"{source}: {topic}", message, recording.times)):
                points += len(part.points)
                pose = transforms.pose(names.fixed, names.base, part.time)
                mount = transforms.pose(names.base, part.frame, part.time)
                if pose is not None and mount is not None:
                    sizes[number] += len(part.points)
                    scans.append((mount.apply(part.points), pose))

    # Two reasons for which nothing is left
    if not points:
        raise RequestError(f"{source}: {counted(count, 'cloud')} of {topic}, none with points")
    if not scans:
        raise RequestError(
            f"{source}: none of the {count} clouds of {topic} has a transform to "
            f"{names.fixed!r} at its stamp; is another clock in the stamps?"
        )
    return scans, [*sizes.values()], count - len(sizes) - len(repeated), recording


def _parts(cloud: Points) -> Iterator[Points]:
    """Yield the points of a message by the instants at which they were measured."""
    if cloud.shifts is None or not len(cloud.shifts):
        yield cloud
        return
    parts = np.round(cloud.shifts / _PART).astype(np.int64)
    for part in np.unique(parts):
        yield Points(cloud.time + _PART * part, cloud.frame, cloud.points[parts == part])


def _seen(scans: Scans, ahead: float, reach: float, cell: float) -> FloatArray:
    """Return the points of all scans in the fixed frame, without the robot's own."""
    parts = [np.empty((0, 3))]
    for points, pose in scans:
        x, y, _ = points.T
        # The box around the robot holds its own flippers, which scans show too.
        on_robot = (np.abs(x) <= ahead) & (np.abs(y) <= HALF_WIDTH)
        near = np.linalg.norm(points, axis=1) <= reach
        parts.append(_thinned(pose.apply(points[near & ~on_robot]), cell))
    return np.concatenate(parts)


def _thinned(points: FloatArray, cell: float) -> FloatArray:
    """Return the mean of the points in each cube of edge ``cell`` [m], (C, 3), sorted by cube."""
    if not len(points):
        return points
    # One number for each cube that has points; the means follow its order.
    cubes = np.floor(points / cell).astype(np.int64)
    _, group = np.unique(cubes, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    return np.column_stack([np.bincount(group, weights=axis) / count for axis in points.T])


def read_folder(folder: Path, but: Path | None = None) -> tuple[Scans, FloatArray | None]:
    """Return the clouds with their poses, and their stamps, (C,) [s], if the poses have any.

    ``but``: a file that is none of the clouds, although it may be in the folder.
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

    # TUM's lines with stamp and quaternion
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
        raise missing_extra(f"{file}", error.name or "trimesh") from error
    except Exception as error:  # each library has its own errors for damaged files
        text = " ".join(str(error).split())
        raise RequestError(f"{file} cannot be read: {type(error).__name__}: {text}") from error

    # Points that did not return are not finite.
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] < 3:
        raise RequestError(
            f"{file}: an array of points (P, 3) is allowed; its shape is {array.shape}"
        )
    array = array[:, :3]
    return array[np.isfinite(array).all(axis=1)]
