"""A robot's recording: what its devices said, and what a policy would have done, as a log.

In: a bag of ROS 1 or 2 and the names of its topics, frames and joints; an exported policy. Out:
clouds, attitudes, joint angles and belt speeds as ``FlipperController.step`` takes them, each with
the time at which it was recorded. In shadow mode, a file of JSON lines, and how often each fault
came. The bag is read twice, first for its transforms, and never held in memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flipperctl.api import Sensor
from flipperctl.core.lidar.body import mounting
from flipperctl.core.lidar.ground import Lidar
from flipperctl.errors import RequestError
from flipperctl.ros.checking import Checked, examine, tells
from flipperctl.ros.messages import quaternion
from flipperctl.ros.reading import (
    Pose,
    Transforms,
    messages,
    opened,
    read_points,
    read_transforms,
    seconds,
    times_of,
)
from flipperctl.ros.topics import Names, Topics, cloud_topic, found_devices
from flipperctl.runtime.messages import (
    CONVENTIONS,
    REP_103,
    Attitude,
    Cloud,
    JointAngles,
    Limits,
    NewestJoints,
    Odometry,
    RobotSetup,
    Signs,
)
from flipperctl.runtime.point_cloud import PointTimes
from flipperctl.runtime.recordings import Shadow
from flipperctl.text.files import OutputKind, write_bytes

Message = Cloud | Attitude | JointAngles | Odometry


class Step(NamedTuple):
    """The messages that a robot received at one time."""

    now: float
    """Time at which they were recorded [s]."""
    messages: dict[str, Message]
    """``cloud``, ``attitude``, ``joints`` or ``odometry`` → message."""


@dataclass(frozen=True)
class Recording:
    """A bag of a robot; ``steps`` reads its messages."""

    path: Path
    names: Names
    checked: Checked
    """What cross-checks found, and the devices that they leave."""
    transforms: Transforms
    times: PointTimes
    """Unit and zero of the times of the points."""
    mount: Pose
    """The sensor of the clouds on the chassis."""
    noted: list[str] = field(default_factory=list)
    """Remarks on the devices and frames."""

    @property
    def used(self) -> Topics:
        """The topics of the devices that can be used."""
        return self.checked.topics

    @property
    def topics(self) -> dict[str, str]:
        """Device → topic, for the devices that the bag has."""
        used = self.used
        topics = {"cloud": used.clouds, "attitude": used.attitude}
        topics |= {"joints": ", ".join(used.joints), "odometry": used.belts}
        return {device: topic for device, topic in topics.items() if topic}

    @property
    def remarks(self) -> list[str]:
        """What a reader of the result should know; complete once the messages were read."""
        return [*self.noted, *(f"{self.used.clouds}: {text}" for text in self.times.remarks())]

    @property
    def axis(self) -> float:
        """Elevation of the z axis of the clouds' frame, about which a LiDAR turns [rad]."""
        x, _, z = self.mount.directions(np.array([[0.0, 0.0, 1.0]]))[0].tolist()
        return math.atan2(z, x)

    @property
    def setup(self) -> RobotSetup:
        """Frames and signs of the messages, with all else by default."""
        angles = CONVENTIONS[self.names.signs]
        # Attitudes are made of quaternions, whose signs are always by REP-103.
        signs = Signs(front=angles.front, rear=angles.rear, pitch=REP_103.pitch)
        return RobotSetup(signs, cloud_frame=self.names.base, attitude_frame=self.names.base)

    def pose(self, time: float) -> Pose | None:
        """Return the chassis in the fixed frame by the bag itself; None if it does not say."""
        if not (self.transforms.has(self.names.base) or self.names.base == self.names.fixed):
            return None
        return self.transforms.pose(self.names.fixed, self.names.base, time)

    def steps(self) -> Iterator[Step]:
        """Yield the messages in the order in which they were recorded, all of one time at once.

        The points of clouds come as a ``Mount`` would measure them, so that rings stay rings. It is
        at the place of the sensor ahead of and above the chassis centre, (x, 0, z), with its
        ``axis``.
        """
        # Topic → device; several topics may have joints.
        used, clouds, last = self.used, -1, -math.inf
        devices = {used.clouds: "cloud", **dict.fromkeys(used.joints, "joints")}
        others = ("attitude", used.attitude), ("odometry", used.belts)
        devices |= {topic: device for device, topic in others if topic}
        joints = NewestJoints(self.names.front, self.names.rear, self.names.scale)
        scale = self.names.belt_scale
        waiting: Step | None = None
        with opened(self.path) as reader:
            for topic, received, message in messages(reader, devices):
                now = received
                if self.checked.by_stamps:
                    stamp = seconds(message.header.stamp) if hasattr(message, "header") else last
                    now = last = max(last, stamp)
                content: Message | None
                match device := devices[topic]:
                    case "cloud":
                        clouds += 1
                        again = clouds in self.checked.repeated
                        content = None if again else self._cloud(message)
                    case "attitude":
                        content = self._attitude(message)
                    case "joints":
                        content = self._joints(joints, topic, message)
                    case _ if hasattr(message, "twist"):
                        speed = float(message.twist.twist.linear.x)
                        content = Odometry(_stamp(message), scale * speed)
                    case _:  # it has no stamp of its own
                        content = Odometry(now, scale * float(message.data))
                if content is None:
                    continue

                # Messages of one time go together, but no device twice.
                if waiting is not None and (now != waiting.now or device in waiting.messages):
                    yield waiting
                    waiting = None
                waiting = waiting or Step(now, {})
                waiting.messages[device] = content
        if waiting is not None:
            yield waiting

    def _joints(self, joints: NewestJoints, topic: str, message: Any) -> JointAngles | None:
        """Return the newest angles; None as long as one is unknown, or of other joints."""
        device_joints = self.used.joints[topic]
        pairs = zip(message.name, message.position, strict=False)
        angles = {name: angle for name, angle in pairs if name in device_joints}
        return joints.take(_stamp(message), angles.keys(), angles.values())

    def _cloud(self, message: Any) -> Cloud:
        # Where the sensor was when the cloud was measured
        read = read_points(f"{self.path}: {self.used.clouds}", message, self.times)
        mount = self.transforms.pose(self.names.base, read.frame, read.time)
        time, ages = read.time, None
        if read.shifts is not None and len(read.shifts):
            # Drivers stamp the beginning or the end of a turn; a cloud of the runtime has its end.
            end = max(0.0, float(read.shifts.max()))
            time, ages = read.time + end, end - read.shifts
        if mount is None:  # refused by its frame
            return Cloud(time, read.frame, read.points, ages)

        # Moved into the chassis, but seen from the mount, so that rings are still rings
        points = mount.apply(read.points) - self.mount.place * (1.0, 0.0, 1.0)
        return Cloud(time, self.names.base, points @ mounting(self.axis), ages)

    def _attitude(self, message: Any) -> Attitude | None:
        if not tells(message):
            return None
        frame, time = message.header.frame_id.lstrip("/"), _stamp(message)
        q, rates = message.orientation, message.angular_velocity

        # What the unit measured, turned into the chassis where it is mounted otherwise
        turn = np.array([q.x, q.y, q.z, q.w])
        rate = np.array([rates.x, rates.y, rates.z])
        if frame != self.names.base:
            mount = self.transforms.pose(self.names.base, frame, time)
            if mount is None:
                return Attitude(time, frame, 0.0, 0.0, 0.0)  # refused by its frame
            # The chassis in the world is the unit in the world after the chassis in the unit.
            turn = Pose(np.zeros(3), turn).after(mount.inverse()).turn
            rate = mount.directions(rate[None])[0]
        x, y, z, w = turn.tolist()
        about = float(rate[0]), float(rate[1]), float(rate[2])
        return Attitude.from_imu(time, self.names.base, (x, y, z, w), about)


def read_recording(
    path: Path, names: Names, *, clouds: bool = True, motion: bool = True
) -> Recording:
    """Return what a bag holds of ``clouds`` and ``motion``; its messages are not read yet."""
    remarks: list[str] = []
    with opened(path) as reader:
        # The devices, and where each is
        topics = (
            found_devices(path, reader, names, remarks, clouds=clouds)
            if motion
            else Topics(cloud_topic(path, reader, names))
        )
        transforms = read_transforms(path, reader)
        frames = (m.header.frame_id.lstrip("/") for *_, m in messages(reader, [topics.clouds]))
        frame, at = next(frames, names.base), names.mount
        if at is not None and frame != names.base and not transforms.has(frame):
            turn = np.array(quaternion(mounting(at.axis)))
            transforms.add(names.base, frame, None, Pose(np.array([at.x, 0.0, at.z]), turn))
        times = times_of(path, reader, topics.clouds)
        checked = examine(reader, names, transforms, topics)
        checked.require(path)

        # Where the sensor is: the first cloud whose transform is known tells.
        heads = (message.header for *_, message in messages(reader, [topics.clouds]))
        places = (
            transforms.pose(names.base, head.frame_id, seconds(head.stamp)) for head in heads
        )  # transforms may begin later than the clouds
        mount = next((place for place in places if place is not None), Pose.none())
    remarks += [*checked.remarks, *transforms.remarks(names.fixed, names.base)]
    return Recording(path, names, checked, transforms, times, mount, remarks)


def _stamp(message: Any) -> float:
    """Return the stamp of a message [s]; NaN without one, which the intake refuses."""
    return seconds(message.header.stamp) or math.nan


LOG = OutputKind(
    "a log", (".jsonl",), re.compile(rb'\A\{"time": [^\n]*"setpoints": [^\n]*"measured": ')
)
USED = (
    "near",
    "filter_margin",
    "chassis_width",
    "overall_width",
    "pose",
    "range_bias",
    "tilt_wander",
    "tilt_noise",
)
"""Settings of ``perception=lidar`` that the setup of a robot has too."""


def check_used(keys: Iterable[str]) -> None:
    """Refuse settings that are none of a robot's setup, since the policy's file states them."""
    allowed = [f"perception.{name}" for name in USED]
    for key in keys:
        if key not in allowed:
            raise RequestError(
                f"{key}: the policy's file states the robot and, after a training with a LiDAR, "
                f"the settings of its map, which are the default ones otherwise; "
                f"{', '.join(allowed)} are allowed"
            )


def shadow(
    policy: Path,
    source: Path,
    sensor: Sensor,
    pose: str | None,
    names: Names,
    log: Path,
    limits: Limits | None = None,
) -> dict[str, Any]:
    """Write what a policy would have done on a bag; return the numbers.

    ``sensor`` has the widths and errors of the robot, see ``USED``; ``pose`` is ``belts`` or
    ``matched``; None: ``belts``.
    """
    lidar = lidar_of(sensor)
    # What a robot could not do is refused before the bag is read.
    if pose == "true":
        raise RequestError("perception.pose=true: no robot knows this; belts or matched is allowed")

    # The controller of a robot decides on what was recorded.
    recording = read_recording(source, names)
    lines: list[str] = []
    decided = Shadow(policy, setup_of(recording, lidar, pose), lines.append, limits)
    for step in recording.steps():
        decided.take(step.now, step.messages)
    write_bytes(log, "".join(f"{line}\n" for line in lines).encode())
    return {
        "policy": str(policy),
        "source": str(source),
        "output": str(log),
        "topics": recording.topics,
        **decided.summary(),
        "checks": recording.checked.rows,
        "remarks": recording.remarks,
    }


def lidar_of(sensor: Sensor) -> Lidar:
    """Return what a robot knows of the LiDAR of ``sensor``, which has to have one."""
    if sensor.lidar is None:
        raise RequestError(
            f"perception={sensor.plugin_name} has no map of clouds; perception=lidar is allowed"
        )
    return sensor.lidar


def setup_of(recording: Recording, lidar: Lidar, pose: str | None) -> RobotSetup:
    """Return the devices of a recorded robot, with the widths and errors of ``lidar``."""
    x, _, z = recording.mount.place.tolist()
    return replace(
        recording.setup,
        mount=replace(lidar.mount, x=x, z=z, axis=recording.axis),
        chassis_width=lidar.chassis_width,
        overall_width=lidar.overall_width,
        pose="matched" if pose == "matched" else "belts",
        range_bias=lidar.range_bias,
        tilt_error=lidar.tilt_error,
    )
