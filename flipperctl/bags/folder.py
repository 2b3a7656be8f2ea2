"""Read point clouds and their poses from a folder.

In: files of clouds, and ``poses.txt`` with one line for each of them in the order of their names,
2 before 10: 8 numbers, stamp, place and quaternion (x y z qx qy qz qw), as TUM's tools write them,
or 12, the upper rows of the matrix, as KITTI's do. Out: points in the frame of the poses.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.bags.transforms import Pose
from flipperctl.errors import MissingExtraError, RequestError

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
