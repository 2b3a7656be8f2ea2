"""A scan before it enters the map: its motion, mixed returns, and constant errors of the device.

In: points with their ages, poses with their times, points of the first scan on level ground. Out:
the points as one scan from one pose, without mixed ones between an edge and what lies behind it.
Also: how much too long distances are, and by how much the pitch errs. Odometry is from belt speeds
and an inertial unit; belts that slip make the robot seem faster than it is.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray
from flipperctl.core.lidar.body import attitude, heading
from flipperctl.core.lidar.messages import Inertial, Pose, Scan

_STEP = 1e-3  # ages are rounded to multiples of this, so that few attitudes are computed [s]
_LONGEST = 0.5  # older points are taken for as old as this [s]
_UNKNOWN = -math.inf  # time of the pose before any is recorded [s]
_MOST = 256  # poses that are remembered [-]


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
        """Return the pose at a time that may lie before the newest poses.

        ``newest`` is the last one, and the answer unless ``time`` lies before it.
        """
        if time >= self._times[-1]:
            return newest
        return Pose(*self._at(np.array([time]))[0].tolist())

    def correct(self, time: float, before: Pose, pose: Pose) -> Pose:
        """Correct the pose at ``time`` from ``before`` to ``pose``; return the newest one.

        Earlier ones are forgotten. Later ones turn and move with the corrected one.
        """
        # Later poses turn and move with the corrected one.
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
        self._times, self._poses = tuple(times), tuple(_numbers(corrected) for corrected in poses)
        return poses[-1]

    def levelled(
        self, points: FloatArray, ages: FloatArray, time: float, origin: Pose
    ) -> FloatArray:
        """Return where the points of a scan are from ``origin``, (P, 3) [m].

        ``points`` (P, 3) are in frame R at the instant of each, which was its age, (P,) [s], before
        ``time`` [s]. Those returned have the directions of frame M. Poses between two remembered
        ones are interpolated.
        """
        # Points in the order of their ages, rounded so that few attitudes are computed
        steps = np.round(np.clip(ages, 0.0, _LONGEST) / _STEP).astype(np.int64)
        order = None
        if (steps[1:] > steps[:-1]).any():  # not in the order of measurement
            order = np.argsort(-steps, kind="stable")
            points, steps = points.take(order, axis=0), steps[order]

        # One pose for each age, which moves all points of that age
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


_STEEP = 1.5
"""Slope to both neighbours above which a point may be mixed: the tangent of the angle of incidence
on a plane through both [-]."""
_BEND = 1.5
"""Difference of that slope to the next one on either side, which a steep surface does not have [-].
"""
_SAME = 0.001  # elevations of a ring, and azimuths of a column, are this close [rad]
_NEIGHBOURS = 0.12  # largest angle between neighbouring rays [rad]


def without_mixed(scan: Scan) -> Scan:
    """Return the scan without points that lie alone between a near and a far surface.

    Neighbours are found by the directions of the points in frame S: along the rings of a turning
    LiDAR, and across them.
    """
    points = scan.points
    # A ray without length has no direction.
    distance = np.sqrt(np.einsum("ij,ij->i", points, points))
    if len(points) < 5 or not (distance > 0).all():
        return scan
    rays = np.ascontiguousarray(points.T) / distance  # (3, P)
    azimuth, elevation = np.arctan2(rays[1], rays[0]), np.arcsin(np.clip(rays[2], -1, 1))
    mixed = _between(distance, rays, _groups(elevation), azimuth)
    mixed |= _between(distance, rays, _groups(azimuth), elevation)
    return scan.take(np.flatnonzero(~mixed)) if mixed.any() else scan


def _groups(values: FloatArray) -> NDArray[np.int64]:
    """Return the number of the group of close values that each belongs to, (P,)."""
    order = np.argsort(values)
    steps = np.diff(values[order], prepend=values[order[0]]) > _SAME
    groups = np.empty(len(values), np.int64)
    groups[order] = np.cumsum(steps)
    return groups


def _between(
    distance: FloatArray, rays: FloatArray, group: NDArray[np.int64], place: FloatArray
) -> NDArray[np.bool_]:
    """Return which points lie between their neighbours of one group, by ``place``, (P,)."""
    # Neighbours along a ring or a column
    order = np.lexsort((place, group))
    r, grouped = distance[order], group[order]
    x, y, z = (np.diff(axis[order]) for axis in rays)
    sine = np.sqrt(x * x + y * y + z * z)  # of the small angle to the next ray
    next_to = (grouped[1:] == grouped[:-1]) & (sine < _NEIGHBOURS) & (sine > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = 1 - sine**2 / 2

        # The slope to each neighbour: a surface goes on, a mixed point leaps to both sides.
        slope = np.where(next_to, (cosine - r[:-1] / r[1:]) / sine, np.nan)
        before, after = slope[1:-2], slope[2:-1]  # of the third to the third last point
        steep = (np.minimum(np.abs(before), np.abs(after)) > _STEEP) & (before * after > 0)
        alone = (np.abs(before - slope[:-3]) > _BEND) & (np.abs(after - slope[3:]) > _BEND)
    mixed = np.zeros(len(distance), np.bool_)
    mixed[order[2:-2]] = steep & alone
    return mixed


_SIDE = 0.8
"""Largest distance of the points from the robot's middle plane. Points beside the robot tell both
errors apart, since their distances are longer [m]."""
_ACROSS = 0.05  # deviation of the ground's slope across the robot, which is estimated too [rad]
_AHEAD = 0.95  # farthest point ahead of the chassis centre; there is no edge before it [m]
_BETWEEN = 0.35
"""Largest distance from the robot's middle plane of points that it will drive over [m]."""
_ELSEWHERE, _SHARE = 0.04, 0.9
"""Largest distance from the ground of this part of its points, distances that err included [m]."""
_STEEP_RAY = 0.3  # smallest drop of a ray per its length [-]
_APART = 0.08  # points farther than this above or below the ground are not on it [m]
_FEWEST = 30  # points that are needed [-]
_LARGEST = 0.05  # largest error of the distances that is believed [m]
_NOISE, _SHARED = 0.012, 3.0  # deviation of a point's height [m], and points that err alike [-]
_BIAS = 0.02  # deviation of the error of the distances [m]


class StartErrors(NamedTuple):
    """Errors at the start."""

    distance: float = 0.0  # by how much distances are too long [m]
    pitch: float = 0.0  # by how much the pitch is too large [rad]


def is_elsewhere(points: FloatArray, lidar: FloatArray, below: float) -> bool:
    """Return whether points show the ground ahead of the robot elsewhere than level.

    ``points`` (P, 3), none of them the robot's own, the ``lidar`` and ``below`` are as for
    ``start_errors``. Too few points show nothing.
    """
    drop, off, ahead = _seen(points, lidar, below, _BETWEEN)
    near = off[ahead & (drop >= _STEEP_RAY)]
    return len(near) >= _FEWEST and float(np.quantile(np.abs(near), _SHARE)) > _ELSEWHERE


def start_errors(points: FloatArray, lidar: FloatArray, below: float, tilt: float) -> StartErrors:
    """Return the likely errors; 0 if too few points show the ground.

    ``points`` (P, 3) and the place of the ``lidar`` (3,) are relative to the chassis centre in
    axes that are level by the measured pitch. The ground lies ``below`` the centre [m]. ``tilt``:
    standard deviation of the pitch, 0 if it does not err [rad].
    """
    drop, off, ahead = _seen(points, lidar, below, _SIDE)
    used = ahead & (drop >= _STEEP_RAY) & (np.abs(off) <= _APART)
    if used.sum() < _FEWEST:
        return StartErrors()
    # The heights are linear in the errors, so that one step of least squares finds them.
    slopes = np.column_stack([-drop[used], points[used, 0], points[used, 1]])  # of the height
    prior = np.array([_BIAS, max(tilt, 1e-9), _ACROSS])
    # In units of the deviations, so that a tilt of 0 leaves a regular system.
    scaled = slopes * prior / (_NOISE * np.sqrt(_SHARED))
    target = off[used] / (_NOISE * np.sqrt(_SHARED))
    errors = prior * np.linalg.solve(scaled.T @ scaled + np.eye(3), scaled.T @ target)
    if abs(errors[0]) > _LARGEST:
        return StartErrors()
    return StartErrors(float(errors[0]), float(errors[1]) if tilt else 0.0)


def _seen(
    points: FloatArray, lidar: FloatArray, below: float, side: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return drops per length of the rays [-], heights above level [m], and which are close ahead.

    All (P,); ``side``: largest distance from the robot's middle plane [m].
    """
    rays = points - lidar
    length = np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    x, y, z = points.T
    return -rays[:, 2] / length, z + below, (x > lidar[0]) & (x < _AHEAD) & (np.abs(y) <= side)


def without_bias(scan: Scan, bias: float) -> Scan:
    """Return the scan with all distances shorter by ``bias`` [m]."""
    if not bias:
        return scan
    distance = np.linalg.norm(scan.points, axis=1, keepdims=True)
    return replace(scan, points=scan.points * (1 - bias / np.maximum(distance, 2 * abs(bias))))


_LONGEST_STEP = 0.5  # longest pause between two messages over which a motion is integrated [s]


def advanced(pose: Pose, inertial: Inertial, speed: float, elapsed: float) -> Pose:
    """Return the pose after the robot has moved along its chassis for ``elapsed`` [s].

    ``speed``: speed of the belts [m/s]. After a pause in the messages the motion is unknown, and
    only ``_LONGEST_STEP`` of it is integrated.
    """
    elapsed = min(max(elapsed, 0.0), _LONGEST_STEP)
    yaw = pose.yaw + inertial.yaw_rate * elapsed
    x, y, z = (speed * elapsed * heading(inertial.pitch, yaw)).tolist()
    return Pose(pose.x + x, pose.y + y, pose.z + z, inertial.roll, inertial.pitch, yaw)


def moved_to(pose: Pose, position: FloatArray) -> Pose:
    """Return the pose at another ``position``, (3,) [m]."""
    x, y, z = position.tolist()
    return replace(pose, x=x, y=y, z=z)
