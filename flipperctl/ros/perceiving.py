"""Perception once more on what a robot has recorded: does its sensing do?

In: a bag, or a folder of clouds with poses. Out: what the estimator of ``perception=lidar`` knew of
the ground at each decision, and how it fared. That is the scans that it refused, coverage,
certainty, times, and how far its odometry drifts from the poses that the bag holds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Robot, Sensor
from flipperctl.core.lidar.body import attitude, mounting
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.messages import PerceptionError, Pose, Scan
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround
from flipperctl.errors import RequestError
from flipperctl.ros.ground import POSES, read_folder
from flipperctl.ros.reading import Pose as FramePose
from flipperctl.ros.reading import estimated
from flipperctl.ros.recording import Recording, Step, lidar_of, read_recording
from flipperctl.ros.topics import Names
from flipperctl.runtime.intake import Intake
from flipperctl.runtime.messages import Cloud, Limits, RobotSetup


def drift(poses: Sequence[tuple[Pose, Pose]]) -> dict[str, float | None] | None:
    """Return how far a way drifts from another one, each relative to its own start.

    ``poses``: of both ways at the same instants; None without any. ``way`` is the length of the
    second one, and ``horizontal`` and ``height`` are the errors at its end [m]. ``share`` is the
    horizontal error per way [-], and ``heading`` is in [rad].
    """
    if not poses:
        return None
    # Each way begins at its own origin and heading, so that only the motion counts.
    estimates, recorded = (
        np.array([_since(way[0], pose) for pose in way]) for way in zip(*poses, strict=True)
    )
    way = float(sum(np.linalg.norm(step) for step in np.diff(recorded[:, :3], axis=0)))
    x, y, z, turn = (estimates[-1] - recorded[-1]).tolist()
    horizontal = math.hypot(x, y)
    return {
        "way": way,
        "horizontal": horizontal,
        "share": horizontal / way if way > 0.1 else None,
        "height": z,
        "heading": math.remainder(turn, 2 * math.pi),
    }


def _since(start: Pose, pose: Pose) -> FloatArray:
    """Return the motion since the start in its heading: x, y and z [m], and the turn [rad]."""
    cos, sin = math.cos(start.yaw), math.sin(start.yaw)
    x, y = pose.x - start.x, pose.y - start.y
    return np.array([cos * x + sin * y, cos * y - sin * x, pose.z - start.z, pose.yaw - start.yaw])


_SIDE = 1.0
"""Points of a scan farther from the robot's middle plane are not shown [m]."""
_MOST_SHOWN = 6000
"""Points of a scan, and of the map, that are kept for a picture [-]."""


@dataclass(frozen=True)
class Instant:
    """What was known of the ground at a decision; all points are in frame L [m]."""

    time: float
    """Time since the first message [s]."""
    cloud: FloatArray
    """(P, 3) points of the latest scan."""
    known: FloatArray
    """(Q, 3) points of the map along the robot."""
    ground: SensedGround
    angles: SensedAngles
    held: str
    """Name of the fault for which a controller would hold; empty without one."""


@dataclass(frozen=True)
class Replay:
    """All decisions of a recording, and what became of its scans."""

    bin_width: float
    """Width of a bin [m]."""
    half_width: float
    """Ground within this distance beside the robot's line counts [m]."""
    instants: list[Instant]
    summary: dict[str, Any]
    """The numbers of ``robot check --json``."""


def replay(source: Path, sensor: Sensor, robot: Robot, pose: str | None, names: Names) -> Replay:
    """Return what the estimator of ``sensor`` makes of a recording.

    ``pose``: ``belts``, ``matched``, or ``true``, which takes the poses of the recording; None: by
    belts if it has an inertial unit and belt speeds, otherwise ``true``.
    """
    lidar_of(sensor)
    if source.is_dir() and (source / POSES).exists():
        if pose not in (None, "true"):
            raise RequestError(
                f"{source}: a folder of clouds has poses alone, so that perception.pose is true; "
                f"{pose} needs a bag with an Imu"
            )
        # The clouds of a folder are in the frame of the chassis.
        place = {"mount_x": 0.0, "mount_z": 0.0, "mount_axis": math.pi / 2, "pose": "true"}
        run = _Run(sensor.model_copy(update=place), "true", robot, RobotSetup())
        scans, stamps = read_folder(source)
        if stamps is None:
            raise RequestError(
                f"{source / POSES}: the clouds have no stamps; 8 numbers a line are needed (stamp, "
                "x, y, z, qx, qy, qz, qw), the first line has 12"
            )
        frame = RobotSetup().cloud_frame
        for (points, where), time in zip(scans, stamps.tolist(), strict=True):
            run.take(Step(time, {"cloud": Cloud(time, frame, points)}), where)
        return run.finish(source, {"cloud": "files"}, [], [])

    # A bag: its devices, as a robot would have received them
    recording = read_recording(source, names)
    x, _, z = recording.mount.place.tolist()
    place = {"mount_x": x, "mount_z": z, "mount_axis": recording.axis}
    place["pose"] = pose = _pose(recording, pose)
    run = _Run(sensor.model_copy(update=place), pose, robot, recording.setup, recording.topics)
    for step in recording.steps():
        cloud = step.messages.get("cloud")
        run.take(step, None if cloud is None else recording.pose(cloud.time))
    for _ in recording.checked.repeated:
        run.refuse("cloud_repeats", "its points are those before, although the robot moved")
    return run.finish(source, recording.topics, recording.remarks, recording.checked.rows)


def _pose(recording: Recording, pose: str | None) -> str:
    """Return how scans shall enter the map; see ``replay``."""
    missing = {"attitude", "odometry"} - recording.topics.keys()
    if pose is None:
        pose = "true" if missing else "belts"
    if pose != "true" and "attitude" in missing:
        raise RequestError(f"{recording.path}: perception.pose={pose} needs an Imu; there is none")
    return pose


class _Run:
    """Feeds an estimator and asks it once in each period, as a controller does."""

    def __init__(
        self,
        sensor: Sensor,
        pose: str,
        robot: Robot,
        setup: RobotSetup,
        topics: Collection[str] = (),
    ) -> None:
        """``topics``: the devices that were recorded; a cloud waits for the posture by them."""
        # The intake of a robot's controller decides which messages count.
        lidar = lidar_of(sensor)
        estimator = sensor.estimator(robot)
        assert isinstance(estimator, LidarEstimator)
        self._estimator, self._pose = estimator, pose
        self._widths = sensor.bin_width, lidar.quality.half_width
        self._tracked = pose == "true"
        self._mount = np.array([lidar.mount.x, 0.0, lidar.mount.z])
        self._turn = mounting(lidar.mount.axis)
        self._limits, self._period = Limits(), robot.decision_period
        needs = () if self._tracked else {"joints", "attitude"} & set(topics)
        self._intake = Intake(setup, self._limits, needs)
        self._instants: list[Instant] = []
        self._refused: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self._scans = 0
        self._begun: float | None = None
        self._due = -math.inf
        self._cloud: FloatArray | None = None
        self._estimates: list[float] = []  # their durations [ms]
        self._updates: list[float] = []  # durations of the scans [ms]
        self._poses: list[tuple[Pose, Pose]] = []  # by the estimator and by the recording
        self._origin: FloatArray | None = None  # the first place of the chassis by the recording

    def take(self, step: Step, where: FramePose | None) -> None:
        """Receive messages; ``where``: the chassis by the recording, if they hold a cloud."""
        self._begun = step.now if self._begun is None else self._begun
        order = ("odometry", "attitude", "joints", "cloud")  # a scan enters at the newest pose
        messages: dict[str, object] = {k: step.messages[k] for k in order if k in step.messages}

        # The pose first, since the scan enters the map where the chassis was
        before = self._intake.refused("cloud")
        if where is not None:  # relative to the first, since maps begin anywhere, as in UTM
            self._origin = where.place if self._origin is None else self._origin
            where = FramePose(where.place - self._origin, where.turn)
        if self._tracked and "cloud" in messages:
            if where is None:
                self.refuse("cloud_pose", "no transform tells where the chassis was")
                return
            self._estimator.update(
                Measured("tracking", step.messages["cloud"].time, estimated(where))
            )

        # Every message that the intake passes, with the time that each scan took
        scans = self._scans
        for device, time, message in self._intake.receive(step.now, **messages):
            begun = perf_counter()
            if not (self._tracked and device in ("attitude", "odometry")):
                self._estimator.update(Measured(device, time, message))
            if isinstance(message, Scan):
                self._updates.append(1000 * (perf_counter() - begun))
                self._scans += 1
                self._cloud = message.points
                if where is not None and not self._tracked:
                    self._poses.append((self._estimator.pose, estimated(where)))

        # A scan may be refused by the intake, or left out as one that is too old.
        fault = self._intake.refused("cloud")
        if "cloud" in messages and fault is not None and fault is not before:
            self.refuse(fault.name, fault.reason)
        elif "cloud" in messages and self._scans == scans:
            self.refuse("cloud_older", "it is no newer than the one before, as of two LiDARs")

        # Decisions at the robot's period, and none to catch up after a pause
        if self._cloud is not None and step.now >= self._due - 1e-6:
            late = step.now - self._due > self._period
            self._due = step.now + self._period if late else self._due + self._period
            self._estimate(step.now, self._cloud)

    def refuse(self, name: str, reason: str) -> None:
        """Count a cloud that is not used."""
        self._refused[name] += 1
        self._reasons.setdefault(name, reason)

    def _estimate(self, now: float, cloud: FloatArray) -> None:
        begun = perf_counter()
        try:
            ground, angles = self._estimator.estimate(now)
        except PerceptionError as error:  # all stamps are far behind the recording's clock
            self.refuse("estimate", str(error))
            return
        self._estimates.append(1000 * (perf_counter() - begun))
        pose, fault = self._estimator.pose, None if self._tracked else self._intake.fault(now)
        seen = 1.0 if ground.seen is None else float(np.mean(ground.seen))
        held = "coverage" if seen < self._limits.coverage else ""  # no decision is made
        assert self._begun is not None

        # What a picture of this decision shows
        self._instants.append(
            Instant(
                now - self._begun,
                _shown(cloud @ self._turn.T + self._mount, pose),
                _thinned(self._estimator.map_points()),
                ground,
                angles,
                held if fault is None else fault.name,
            )
        )

    def finish(
        self,
        source: Path,
        topics: dict[str, str],
        remarks: list[str],
        checks: list[dict[str, Any]],
    ) -> Replay:
        """Return the result; RequestError if no scan was used."""
        if not (instants := self._instants):
            why = "; ".join(f"{n} × {self._reasons[name]}" for name, n in self._refused.items())
            why = "; ".join([why or "there is none", *remarks])
            raise RequestError(f"{source}: no cloud can be used: {why}")

        # Each bin over all decisions: how often it was seen, and how certain it was
        seen = np.array([instant.ground.seen for instant in instants])  # (T, N)
        filled = [
            instant.ground.filled for instant in instants if instant.ground.filled is not None
        ]
        deviation = np.array([instant.ground.deviation for instant in instants])  # (T, N) [m]
        width, half_width = self._widths
        middle = (np.arange(seen.shape[1]) - (seen.shape[1] - 1) / 2) * width
        summary = {
            "source": str(source),
            "topics": topics,
            "pose": self._pose,
            "seconds": instants[-1].time,
            "scans": self._scans,
            "refused": {
                name: {"count": count, "reason": self._reasons[name]}
                for name, count in self._refused.most_common()
            },
            "decisions": len(instants),
            "held": dict(Counter(instant.held for instant in instants if instant.held)),
            "coverage": {"mean": float(seen.mean()), "least": float(seen.mean(axis=1).min())},
            "filled": float(np.concatenate(filled).mean()),
            "deviation": _median(deviation[np.isfinite(deviation)]),
            "bins": [
                {
                    "x": round(float(x), 4),
                    "seen": float(seen[:, i].mean()),
                    "deviation": _median(deviation[seen[:, i], i]),
                }
                for i, x in enumerate(middle)
            ],
            "estimate_ms": _quantiles(self._estimates),
            "scan_ms": _quantiles(self._updates),
            "drift": drift(self._poses),
            "checks": checks,
            "remarks": remarks,
        }
        return Replay(width, half_width, instants, summary)


def _shown(points: FloatArray, pose: Pose) -> FloatArray:
    """Return points in frame R near the robot, in frame L, (P, 3) [m]."""
    level = points @ attitude(pose.roll, pose.pitch, 0.0).T
    return _thinned(level[np.abs(level[:, 1]) <= _SIDE])


def _thinned(points: FloatArray) -> FloatArray:
    return points[:: 1 + len(points) // _MOST_SHOWN]


def _median(values: FloatArray) -> float | None:
    return float(np.median(values)) if len(values) else None


def _quantiles(durations: list[float]) -> dict[str, float]:
    return {f"p{q}": round(float(np.percentile(durations, q)), 3) for q in (50, 99)}
