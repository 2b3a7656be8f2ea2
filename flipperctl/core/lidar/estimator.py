"""The estimator of ``perception=lidar``, which runs on a robot too.

In: messages of the devices with their times. Out: the sensed ground and posture.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray
from flipperctl.core.lidar.body import Body, Mount, attitude
from flipperctl.core.lidar.ground import GroundSeen, MapSettings
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.core.lidar.messages import (
    Belts,
    Inertial,
    Joints,
    PerceptionError,
    Pose,
    Scan,
    checked,
    number,
    thinned,
    without_near,
)
from flipperctl.core.lidar.scans import (
    StartErrors,
    Trail,
    advanced,
    is_elsewhere,
    moved_to,
    start_errors,
    without_bias,
    without_mixed,
)
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround
from flipperctl.core.targets import angles_of

_OLDEST = 5.0  # largest age of the newest message with which an estimate is made [s]

_MOST_POINTS = 10_000
"""Points of a turn that are used; more are thinned, since the map keeps no more of them [-]."""
_TURN, _LEAST_SHARE = 0.1, 0.05
"""Time of a turn [s]. A scan that follows the one before sooner is a sector, which has this part of
the points of a turn, or more [-]."""
_LEVEL, _LEVEL_ON_BELTS = 0.1, 0.02
"""Largest pitch of a robot that stands on level ground at the start: on its flippers, and on the
belts of its chassis, besides three deviations of the measured pitch [rad]."""
_LOWERED = 0.01  # angle by which a flipper is lowered [rad]
_FADING = 30.0  # time in which an inertial unit's error of the pitch changes [s]


class LidarEstimator:
    """Puts scans into a map at the pose of the robot."""

    def __init__(
        self,
        body: Body,
        mount: Mount,
        settings: MapSettings,
        matcher: ScanMatcher | None = None,
        *,
        level: bool = True,
    ) -> None:
        """``matcher`` corrects the pose by ``Belts`` and ``Inertial``; None: nothing does.

        ``level``: whether the robot stands on level ground at first; else no ground and no
        constant errors are assumed.
        """
        self._body, self._mount = body, mount
        self._settings = settings
        self._ground = GroundSeen(settings)
        self._matcher = matcher
        self._pose = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._trail = Trail(self._pose)
        self._joints = Joints(0.0, 0.0)
        self._speed = 0.0  # of the belts [m/s]
        self._reckoned: float | None = None  # time to which odometry has moved the pose [s]
        self._started = not level
        self._errors = StartErrors()
        self._calibrated: float | None = None if level else 0.0  # when these were estimated [s]
        self._newest: float | None = None  # time of the newest message [s]
        self._scanned: float | None = None  # time of the newest scan [s]

    def update(self, measured: Measured) -> None:
        """Receive a message; a scan comes last among messages of one time.

        The pose is the latest ``Pose``, moved on by ``Belts`` and ``Inertial``. A message
        with numbers that cannot be is dropped, and the previous one stays in force.

        Raises:
            PerceptionError: the message is malformed.
        """
        message = checked(measured.time, measured.value)
        if message is None:
            return
        time, value = message
        self._newest = time
        if isinstance(value, Scan):
            # A scan soon after the one before is a sector, which has a part of a turn's points.
            elapsed = math.inf if self._scanned is None else time - self._scanned
            self._scanned = time
            # A turn is not always exactly 0.1 s.
            share = round(min(1.0, max(_LEAST_SHARE, elapsed / _TURN)), 3)
            value = thinned(without_near(value, self._mount.near), round(_MOST_POINTS * share))
            value = without_mixed(value)
            pose = self._trail.pose_at(time, self._pose)  # newer attitudes may have come first
            if self._calibrated is None:
                self._begin(value, time, pose)
            self._add(without_bias(value, self._errors.distance), time, pose)
        else:
            self._receive(value, time)

    def _begin(self, scan: Scan, time: float, pose: Pose) -> None:
        """Assume ground at the start, and estimate the constant errors, by the first scan.

        On level ground the robot knows how far that is below. Nothing is assumed if the scan shows
        the ground ahead elsewhere.
        """
        # Whether the ground ahead is where a level floor would be
        turn = attitude(pose.roll, pose.pitch, 0.0)
        lidar, below = turn @ self._mount.position, self._below()
        ground = self._ground_points(scan)[0] @ turn.T
        if self._stands_level(pose) and is_elsewhere(ground, lidar, below):
            self._started, self._calibrated = True, 0.0
            return
        self._start(pose)
        if self._calibrated is not None:
            return

        # Level ground tells by how much distances and pitch err.
        self._calibrated = time
        points = lidar + scan.points @ (turn @ self._mount.turn).T
        self._errors = start_errors(points, lidar, below, self._tilt())

    def _tilt(self) -> float:
        """Return the standard deviation of the pitch, 0 if it does not err [rad]."""
        return 0.0 if self._reckoned is None else self._settings.accuracy.tilt

    def _stands_level(self, pose: Pose) -> bool:
        """Return whether the robot may stand on level ground, by its pitch and its flippers."""
        # On lowered flippers the chassis may pitch more.
        lowered = min(angles_of(self._joints)) < -_LOWERED
        limit = _LEVEL if lowered else min(_LEVEL, _LEVEL_ON_BELTS + 3 * self._tilt())
        return abs(pose.pitch) <= limit

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
            if self._calibrated is not None:  # the error of the start, which fades
                fading = math.exp(-max(0.0, time - self._calibrated) / _FADING)
                value = replace(value, pitch=value.pitch - fading * self._errors.pitch)
            self._pose = advanced(self._pose, value, self._speed, elapsed)
            self._reckoned = time
            self._trail.record(time, self._pose)

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the ground and the posture by the latest messages.

        The older these are, the less certain are the heights.

        Raises:
            PerceptionError: nothing was measured, or not for ``_OLDEST``.
        """
        # What the robot has driven since the newest message is not known.
        unknown = abs(self._speed) * self._age(time)
        self._start(self._pose)
        pose, joints = self._pose, self._joints
        circles = self._body.circles(pose.pitch, angles_of(joints))
        position, radius = np.array([pose.x, pose.y, pose.z]), self._body.track_radius
        ground = self._ground.sensed(position, pose.yaw, circles, radius, unknown, pose.roll)
        ground = replace(ground, position=np.array([pose.x, pose.z]))
        pair, four = (joints.front, joints.rear), joints.flippers
        return ground, SensedAngles(*pair, pitch=pose.pitch, roll=pose.roll, flippers=four)

    @property
    def pose(self) -> Pose:
        """Pose of the robot by the latest messages."""
        return self._pose

    def map_points(self) -> FloatArray:
        """Return the points of the map along the robot, (P, 3) in frame L [m], for pictures."""
        pose = self._pose
        return self._ground.points_around(np.array([pose.x, pose.y, pose.z]), pose.yaw)

    def _age(self, time: float) -> float:
        """Return the time since the newest message, 0 or more [s]."""
        now = number(time, "the time of an estimate")
        if not math.isfinite(now):
            raise PerceptionError(f"the time of an estimate is {now}; a finite one is needed")
        if self._newest is None:
            raise PerceptionError("nothing was measured yet")
        if (age := now - self._newest) > _OLDEST:
            raise PerceptionError(f"the newest message is {age:.3g} s old; {_OLDEST:g} s at most")
        return max(0.0, age)

    def _start(self, pose: Pose) -> None:
        """Assume ground below and behind the robot, which stands on it, at the start.

        It is level, or rises as the chassis does if that is on a slope or a stair.
        """
        if self._started:
            return
        self._started = True
        # Ground up to the front hinge, level or as steep as the chassis
        hinge = self._body.chassis_length / 2 - self._body.track_radius
        until = pose.x * math.cos(pose.yaw) + pose.y * math.sin(pose.yaw) + hinge
        if self._stands_level(pose):
            self._ground.assume_level(until, pose.yaw, pose.z - self._below())
            return
        self._calibrated = 0.0  # by level ground alone
        slope = math.tan(pose.pitch)
        below = self._body.track_radius / math.cos(pose.pitch)
        self._ground.assume_level(until, pose.yaw, pose.z - below + slope * hinge, slope)

    def _below(self) -> float:
        """Return the height of the chassis centre above level ground on which it stands [m]."""
        body = self._body
        lowered = max(0.0, *(-math.sin(angle) for angle in angles_of(self._joints)))
        return body.track_radius + lowered * (body.flipper_length - 2 * body.track_radius)

    def _add(self, scan: Scan, time: float, pose: Pose) -> None:
        """Put a scan into the map where it was measured, at ``pose``, and correct that by it.

        Poses of newer attitudes, which came before the scan, are corrected alike.
        """
        before = pose
        # Every point as it was seen at its own time, from where the robot is now
        points, mask = self._ground_points(scan)
        if scan.ages is None or not self._settings.quality.deskew:
            points = points @ attitude(pose.roll, pose.pitch, pose.yaw).T
        else:
            points = self._trail.levelled(points, scan.ages[mask], time, pose)

        # First the position by scan matching, then the height by the map
        if self._matcher is not None:
            guess = np.array([pose.x, pose.y, pose.z])
            facing = attitude(pose.roll, pose.pitch, pose.yaw)[:, 0]
            position, turn = self._matcher.corrected(points, guess, facing)
            pose = moved_to(replace(pose, yaw=pose.yaw + turn), position)
        points += (pose.x, pose.y, pose.z)

        # Slipping belts lift the pose off the map or sink it.
        if self._reckoned is not None:
            error = self._ground.height_error(points, pose.x, pose.y, pose.yaw)
            pose = moved_to(pose, np.array([pose.x, pose.y, pose.z - error]))
            points[:, 2] -= error
        self._pose = self._trail.correct(time, before, pose)

        # Rays clear what they have passed; clouds in frame R do not tell where rays began.
        if self._mount.tells_rays:
            origin = np.array([pose.x, pose.y, pose.z])
            origin += attitude(pose.roll, pose.pitch, pose.yaw) @ self._mount.position
            self._ground.clear(origin, points, pose.x, pose.y)
        self._ground.add(points, pose.x, pose.y, pose.yaw)

    def _ground_points(self, scan: Scan) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return what ``Mount.ground_points`` keeps of a scan, with the flippers where they are."""
        return self._mount.ground_points(scan.points, self._body, self._joints)

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later messages do not change."""
        latest = self._pose, self._joints, self._speed, self._reckoned, self._newest, self._scanned
        matched = None if self._matcher is None else self._matcher.save()
        started = self._started, self._errors, self._calibrated
        return self._ground.save(), latest, started, matched, self._trail.save()

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        ground, latest, (self._started, self._errors, self._calibrated), matched, trail = saved
        self._trail.load(trail)
        if self._matcher is not None:
            self._matcher.load(matched)
        self._pose, self._joints, self._speed, self._reckoned, self._newest, self._scanned = latest
        self._ground.load(ground)
