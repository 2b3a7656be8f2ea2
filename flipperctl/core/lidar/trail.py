"""The robot's motion within a scan, by which its points are corrected ("de-skewed").

In: poses with their times, points with their ages. Out: the points as one scan from one pose. A
LiDAR that turns measures the points of a scan at different times, from a robot that moves.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.messages import Pose
from flipperctl.core.lidar.rotations import attitude

_STEP = 1e-3
"""Ages are rounded to multiples of this, so that few attitudes are computed [s]."""
_LONGEST = 0.5
"""Older points are taken for as old as this [s]."""
_UNKNOWN = -math.inf
"""Time of the pose before any is recorded [s]."""
_MOST = 256
"""Poses that are remembered [-]."""


class Trail:
    """The latest poses of the robot."""

    def __init__(self, pose: Pose) -> None:
        """``pose``: the one at all times, until the first is recorded."""
        self._times: tuple[float, ...] = (_UNKNOWN,)
        self._poses: tuple[tuple[float, ...], ...] = (_numbers(pose),)

    def record(self, time: float, pose: Pose) -> None:
        """Remember the ``pose`` at a ``time`` [s]; poses that are not older are forgotten."""
        while self._times and (self._times[-1] >= time or self._times[-1] == _UNKNOWN):
            self._times, self._poses = self._times[:-1], self._poses[:-1]
        self._times = (*self._times, time)[-_MOST:]
        self._poses = (*self._poses, _numbers(pose))[-_MOST:]

    def pose_at(self, time: float, newest: Pose) -> Pose:
        """Return the pose at a time that may lie before those of the newest poses.

        ``newest`` is the last one, and the answer unless ``time`` lies before it.
        """
        if time >= self._times[-1]:
            return newest
        return Pose(*self._at(np.array([time]))[0].tolist())

    def correct(self, time: float, before: Pose, pose: Pose) -> Pose:
        """Correct the pose at ``time`` from ``before`` to ``pose``; return the newest one.

        Earlier ones are forgotten. Later ones turn and move with the corrected one.
        """
        turn = pose.yaw - before.yaw
        cosine, sine = math.cos(turn), math.sin(turn)
        later = [at for at, then in enumerate(self._times) if then > time]
        times, poses = [time], [pose]
        for at in later:
            x, y, z, roll, pitch, yaw = self._poses[at]
            x, y = x - before.x, y - before.y
            moved = pose.x + cosine * x - sine * y, pose.y + sine * x + cosine * y
            times.append(self._times[at])
            poses.append(Pose(*moved, pose.z + z - before.z, roll, pitch, yaw + turn))
        self._times, self._poses = tuple(times), tuple(_numbers(one) for one in poses)
        return poses[-1]

    def levelled(
        self, points: FloatArray, ages: FloatArray, time: float, origin: Pose
    ) -> FloatArray:
        """Return where the points of a scan are from ``origin``, (P, 3) [m].

        ``points`` (P, 3) are in frame R at the instant of each, which was its age, (P,) [s], before
        ``time`` [s]. Those returned have the directions of frame M. Poses between two remembered
        ones are interpolated.
        """
        steps = np.round(np.clip(ages, 0.0, _LONGEST) / _STEP).astype(np.int64)
        order = None
        if (steps[1:] > steps[:-1]).any():  # not in the order of measurement
            order = np.argsort(-steps, kind="stable")
            points, steps = points.take(order, axis=0), steps[order]
        borders = np.flatnonzero(np.diff(steps, prepend=-1, append=-1))
        distinct = steps[borders[:-1]]
        poses = self._at(np.asarray(time - _STEP * distinct, np.float64))
        poses[:, :3] -= origin.x, origin.y, origin.z
        moved = np.empty_like(points)
        for then, pose in zip(pairwise(borders.tolist()), poses.tolist(), strict=True):
            part = slice(*then)
            moved[part] = points[part] @ attitude(*pose[3:]).T + pose[:3]
        if order is None:
            return moved
        result = np.empty_like(moved)
        result[order] = moved
        return result

    def _at(self, times: FloatArray) -> FloatArray:
        """Return the poses at these times, (T, 6) in the order of ``Pose``."""
        known = np.array(self._poses)
        known[:, 5] = np.unwrap(known[:, 5])
        return np.column_stack([np.interp(times, self._times, column) for column in known.T])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot."""
        return self._times, self._poses

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._times, self._poses = saved


def _numbers(pose: Pose) -> tuple[float, ...]:
    return pose.x, pose.y, pose.z, pose.roll, pose.pitch, pose.yaw
