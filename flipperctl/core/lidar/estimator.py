"""The estimator of ``perception=lidar``, which runs on a robot too.

In: messages of the devices with their times. Out: the sensed ground and posture.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.ground import GroundSeen, MapSettings, Stance
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Pose, Scan
from flipperctl.core.lidar.odometry import advanced, moved_to
from flipperctl.core.lidar.rotations import attitude, mounting
from flipperctl.core.lidar.trail import Trail
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround


@dataclass(frozen=True)
class Mount:
    """Where the LiDAR is on the robot, and which of its points count."""

    x: float
    """Position ahead of the chassis centre, along the chassis [m]."""
    z: float
    """Height above the chassis centre [m]."""
    axis: float
    """Elevation of the axis of its rings [rad]."""
    near: float
    """Points closer than this to the LiDAR are dropped [m]."""
    margin: float
    """Points closer than this to the robot's own shape are dropped [m]."""


class LidarEstimator:
    """Puts scans into a map at the pose of the robot."""

    def __init__(
        self,
        body: Body,
        mount: Mount,
        settings: MapSettings,
        matcher: ScanMatcher | None = None,
        deskew: bool = True,
    ) -> None:
        """``matcher`` corrects the pose by ``Belts`` and ``Inertial``; None: nothing does.

        ``deskew``: correct the points for the robot's motion within a scan.
        """
        self._body, self._mount = body, mount
        self._position_of_lidar = np.array([mount.x, 0.0, mount.z])
        self._turn = mounting(mount.axis)
        self._ground = GroundSeen(settings)
        self._matcher, self._deskew = matcher, deskew
        self._pose = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._trail = Trail(self._pose)
        self._joints = Joints(0.0, 0.0)
        self._speed = 0.0  # of the belts [m/s]
        self._reckoned: float | None = None  # time to which odometry has moved the pose [s]
        self._started = False

    def update(self, measured: Measured) -> None:
        """Receive a message; of those of one time, the scan comes last.

        The pose is that of the latest ``Pose``, moved on by ``Belts`` and ``Inertial``. A message
        with numbers that are not finite is dropped, and the previous one stays in force.
        """
        value = measured.value
        if isinstance(value, Scan):
            self._start()
            self._add(value, measured.time)
        elif isinstance(value, Pose | Joints | Inertial | Belts) and _is_finite(value):
            self._receive(value, measured.time)

    def _receive(self, value: Pose | Joints | Inertial | Belts, time: float) -> None:
        if isinstance(value, Pose):
            self._pose, self._reckoned = value, None
            self._trail.record(time, value)
        elif isinstance(value, Joints):
            self._joints = value
        elif isinstance(value, Belts):
            self._speed = value.speed
        else:
            elapsed = 0.0 if self._reckoned is None else time - self._reckoned
            self._pose = advanced(self._pose, value, self._speed, elapsed)
            self._reckoned = time
            self._trail.record(time, self._pose)

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the ground and the posture by the latest messages."""
        self._start()
        pose, joints = self._pose, self._joints
        circles = self._body.circles(pose.pitch, joints.front, joints.rear)
        stance = Stance(circles, self._body.track_radius)
        ground = self._ground.sensed(np.array([pose.x, pose.y, pose.z]), pose.yaw, stance)
        ground = replace(ground, position=np.array([pose.x, pose.z]))
        return ground, SensedAngles(front=joints.front, rear=joints.rear, pitch=pose.pitch)

    def _start(self) -> None:
        """Assume level ground below and behind the robot, which stands on it, at the start."""
        if self._started:
            return
        self._started = True
        body, joints = self._body, self._joints
        hinge = body.chassis_length / 2 - body.track_radius
        lowered = max(0.0, -math.sin(joints.front), -math.sin(joints.rear))
        below = body.track_radius + lowered * (body.flipper_length - 2 * body.track_radius)
        self._ground.assume_level(self._pose.x + hinge, self._pose.z - below)

    def _add(self, scan: Scan, time: float) -> None:
        pose = self._pose
        points = self._levelled(scan, time)
        if self._matcher is not None:
            guess = np.array([pose.x, pose.y, pose.z])
            pose = moved_to(pose, self._matcher.corrected(points, guess))
        points += (pose.x, pose.y, pose.z)
        if self._reckoned is not None:  # slipping belts lift the pose off the map or sink it
            error = self._ground.height_error(points, pose.x, pose.y, pose.yaw)
            pose = moved_to(pose, np.array([pose.x, pose.y, pose.z - error]))
            points[:, 2] -= error
        self._pose = pose
        self._trail.begin(time, pose)
        self._ground.add(points, pose.x, pose.y)

    def _levelled(self, scan: Scan, time: float) -> FloatArray:
        """Return the ground's points from the robot in the directions of frame M, (P, 3) [m]."""
        pose, ages = self._pose, scan.ages
        kept = np.asarray(np.isfinite(scan.points).all(axis=1))
        if ages is not None:
            kept &= np.isfinite(ages)
        points = self._of_ground(scan.points, kept)
        if ages is None or not self._deskew:
            return points @ attitude(pose.roll, pose.pitch, pose.yaw).T
        return self._trail.levelled(points, ages[kept], time, pose)

    def _of_ground(self, points: FloatArray, kept: NDArray[np.bool_]) -> FloatArray:
        """Return those of the ``kept`` points that are not the robot's own, (P, 3) in frame R [m].

        ``kept`` (P,) is changed to which of ``points`` these are.
        """
        points = points[kept]
        far = np.einsum("ij,ij->i", points, points) >= self._mount.near**2
        kept[kept] = far
        points = self._position_of_lidar + points[far] @ self._turn.T
        joints, margin = self._joints, self._mount.margin
        others = ~self._body.contains(points, joints.front, joints.rear, margin)
        kept[kept] = others
        return points[others]

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later messages do not change."""
        latest = self._pose, self._joints, self._speed, self._reckoned
        matched = None if self._matcher is None else self._matcher.save()
        return self._ground.save(), latest, self._started, matched, self._trail.save()

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        ground, latest, self._started, matched, trail = saved
        self._trail.load(trail)
        if self._matcher is not None:
            self._matcher.load(matched)
        self._pose, self._joints, self._speed, self._reckoned = latest
        self._ground.load(ground)


def _is_finite(message: Pose | Joints | Inertial | Belts) -> bool:
    return all(map(math.isfinite, astuple(message)))
