"""A robot's values from its recording, and the robot's file with them.

In: a bag with joints, commands, an ``Imu``, poses and the speed of the belts. Out: what
``estimates`` tells of each value, and a file that ``robot=FILE`` takes, with the intervals as
comments.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Robot
from flipperctl.errors import RequestError
from flipperctl.ros.estimates import Estimate, Motion, estimates
from flipperctl.ros.reading import estimated, messages, opened, seconds
from flipperctl.ros.recording import Recording, read_recording
from flipperctl.ros.topics import Names
from flipperctl.runtime.devices import Devices
from flipperctl.runtime.messages import Attitude, JointAngles, NewestJoints, Odometry
from flipperctl.text.files import OutputKind, write_bytes

FILE = OutputKind("a robot's file", (".yaml", ".yml"), re.compile(rb"\A# The robot of "))
_FEWEST = 3
"""Angles that a motion needs [-]."""
_STALE = 0.5
"""Longest time between two measurements that are joined by a line [s]."""


def identify(
    bag: Path, robot: Robot, devices: Devices, output: Path | None = None
) -> dict[str, Any]:
    """Return what a bag tells of a robot; ``robot`` has its measures and masses.

    ``output``: the robot's file to write.

    Raises:
        RequestError: the bag has no angles of the flippers.
    """
    recording = read_recording(bag, Names.of(devices), clouds=False)
    motion = motion_of(recording, devices)
    estimated = estimates(motion, robot, devices.tilt_error)
    if output is not None:
        write_bytes(output, robot_file(bag, robot, estimated).encode())
    return {
        "source": str(bag),
        "output": None if output is None else str(output),
        "topics": recording.topics,
        "seconds": float(motion.time[-1] - motion.time[0]),
        "values": {key: estimate.to_dict() for key, estimate in estimated.items()},
        "checks": recording.checked.rows,
        "remarks": recording.remarks,
    }


def motion_of(recording: Recording, devices: Devices) -> Motion:
    """Return what the devices of a recording measured, in flipperctl's signs."""
    signs = recording.setup.signs
    joints: list[tuple[float, float, float]] = []
    tilts: list[tuple[float, float]] = []
    belts: list[tuple[float, float]] = []
    for step in recording.steps():
        for message in step.messages.values():
            match message:
                case JointAngles():
                    front, rear = signs.front * message.front, signs.rear * message.rear
                    joints.append((message.time, front, rear))
                case Attitude() if message.frame == recording.names.base:
                    tilts.append((message.time, signs.pitch * message.pitch))
                case Odometry():
                    belts.append((message.time, message.speed))
    angles = np.array([row for row in joints if math.isfinite(row[0])]).reshape(-1, 3)
    _, first = np.unique(angles[:, 0], return_index=True)
    angles = angles[first]
    if len(angles) < _FEWEST:
        raise RequestError(f"{recording.path}: no JointState has the angles of all flippers")

    # The pitch of the poses stands in for an inertial unit
    time = angles[:, 0]
    poses = [recording.pose(at) for at in time.tolist()]
    chassis = [None if pose is None else estimated(pose) for pose in poses]
    places = np.array(
        [(math.nan,) * 5 if c is None else (c.x, c.y, c.z, c.yaw, c.pitch) for c in chassis]
    )
    # An odometry that is the pose as well cannot show that the belts slip
    belts = [] if _is_odometry(recording) else belts
    return Motion(
        time=time,
        angles=angles[:, 1:],
        pitch=_at(time, tilts) if tilts else places[:, 4],
        way=_way(places),
        belts=_at(time, belts),
        commands=_commands(recording, devices, time),
    )


def _is_odometry(recording: Recording) -> bool:
    with opened(recording.path) as reader:
        topic = recording.used.belts
        return any(c.topic == topic and "Odometry" in c.msgtype for c in reader.connections)


def _at(times: FloatArray, rows: list[tuple[float, float]]) -> FloatArray:
    """Return a measurement between its messages, NaN far from any."""
    if not rows:
        return np.full(len(times), math.nan)
    known, values = np.array(sorted(rows)).T
    last = np.clip(np.searchsorted(known, times, "right") - 1, 0, len(known) - 1)
    result = np.interp(times, known, values)
    result[np.abs(times - known[last]) > _STALE] = math.nan
    return np.asarray(result)


def _way(places: FloatArray) -> FloatArray:
    """Return the way along the heading and the height, (N, 2), of x, y, z and heading [m, rad]."""
    heading = np.column_stack([np.cos(places[:, 3]), np.sin(places[:, 3])])
    steps = np.einsum("ij,ij->i", np.diff(places[:, :2], axis=0), heading[:-1])
    way = np.append(0.0, np.nancumsum(steps))
    return np.column_stack([np.where(np.isfinite(places[:, 2]), way, math.nan), places[:, 2]])


def _commands(recording: Recording, devices: Devices, times: FloatArray) -> FloatArray:
    """Return times and targets of both pairs, (M, 3), of the topic with a stamp if there is one."""
    names, signs, topics = recording.names, recording.setup.signs, devices.topics
    ordered = [name.lstrip("-") for name in (*names.front, *names.rear)]
    for topic in (topics.joint_command, topics.flipper_command):
        newest, rows = NewestJoints(names.front, names.rear, names.scale), []
        with opened(recording.path) as reader:
            for _, received, message in messages(reader, [f"/{topic.lstrip('/')}"]):
                stamped = hasattr(message, "position")
                time = seconds(message.header.stamp) if stamped else received
                joints, angles = (
                    (message.name, message.position) if stamped else (ordered, message.data)
                )
                command = newest.take(time, joints, angles)
                if command is not None and times[0] <= time <= times[-1]:
                    rows.append((time, signs.front * command.front, signs.rear * command.rear))
        if rows:
            return np.array(rows)
    return np.empty((0, 3))


def robot_file(bag: Path, robot: Robot, estimates: dict[str, Estimate]) -> str:
    """Return the text of a robot's file: what the bag tells, and all else as ``robot`` has it."""
    slides = estimates["sim.friction"]
    ranges = " ".join(
        f"'randomise.{key}=[{estimate.low:.4g},{estimate.high:.4g}]'"
        for key, estimate in estimates.items()
        if estimate.best is not None
    )
    lines = [
        f"# The robot of {bag.name}, by flipperctl robot identify; intervals of 95 %.",
        "# Friction is a setting of the simulator: "
        f"sim.friction={slides.near(1.0):.3g} # {slides.interval()}: {slides.why}",
        *([f"# Train over the intervals: {ranges}"] if ranges else []),
    ]
    for name, value in robot.model_dump(exclude_none=True).items():
        if (estimate := estimates.get(f"robot.{name}")) is None:
            lines.append(f"{name}: {value}")
        else:
            likely = estimate.near(value)
            lines.append(f"{name}: {likely:.5g} # {estimate.interval()}: {estimate.why}")
    return "\n".join(lines) + "\n"
