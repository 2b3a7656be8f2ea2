"""Export of an episode as a bag of ROS 2 in MCAP, with what a robot would have published.

In: a scene and a policy. Out: a folder with the MCAP file and its metadata, which
``ros2 bag play``, Foxglove and PlotJuggler open. ROS itself is not needed. The messages follow
``messages``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flipperctl.api import FloatArray, Measured, Perception, RobotState, Sensor, World
from flipperctl.config import EvalConfig
from flipperctl.core.lidar.body import attitude
from flipperctl.core.lidar.messages import Belts, Inertial, Scan
from flipperctl.core.targets import angles_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.errors import OutputError, RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros.messages import (
    LEVEL,
    LIDAR,
    Messages,
    nanoseconds,
    require_rosbags,
    typestore,
)
from flipperctl.runtime.devices import Devices
from flipperctl.text.files import new_folder

CLOUD, IMU, JOINT_STATES, ODOMETRY = "/points", "/imu/data", "/joint_states", "/odom"
TRANSFORMS, STATIC, BELTS = "/tf", "/tf_static", "/belt_speed"
OBSERVATION, ACTION = "/flipperctl/observation", "/flipperctl/action"
TARGETS = "/flipper_controller/commands"
"""Topic of ``forward_command_controller`` for a controller of that name."""
TYPES = {
    CLOUD: "sensor_msgs/msg/PointCloud2",
    IMU: "sensor_msgs/msg/Imu",
    JOINT_STATES: "sensor_msgs/msg/JointState",
    ODOMETRY: "nav_msgs/msg/Odometry",
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    STATIC: "tf2_msgs/msg/TFMessage",
    TARGETS: "std_msgs/msg/Float64MultiArray",
    BELTS: "std_msgs/msg/Float64",
    OBSERVATION: "std_msgs/msg/Float64MultiArray",
    ACTION: "std_msgs/msg/Int32",
}
"""Topic → type of its messages."""
_MOUNT = ("mount_x", "mount_z", "mount_axis")
"""Settings of a sensor whose scans are in a frame of their own."""


class Stamped(NamedTuple):
    """A message of a bag."""

    time: float
    """Time since the start of the episode [s]."""
    topic: str
    message: Any


@dataclass
class Watch(Observer):
    """Collects the states at 100 Hz, and all measurements."""

    every = 1
    states: list[RobotState] = field(default_factory=list)
    measurements: list[Measured] = field(default_factory=list)

    def stopped(self, world: World) -> None:
        """Receive the world after a sample."""
        self.states.append(world.state())

    def measured(self, measured: Measured) -> None:
        """Receive a measurement of an instrument."""
        self.measurements.append(measured)


@dataclass
class _Decided:
    """What a policy perceived and chose at one time."""

    time: float
    sensed: float
    """Time of the state that was perceived [s]."""
    perception: Perception
    action: int
    targets: FloatArray
    """(4,) targets in the order of ``JOINTS`` and the signs of ROS [rad]."""


def check_bag(folder: Path) -> None:
    """Check that a bag can be written to a new folder."""
    require_rosbags("a bag")
    if folder.exists():
        raise OutputError(f"{folder} cannot be written: a bag is a new folder, and this one exists")
    if not folder.parent.is_dir():
        raise OutputError(f"{folder} cannot be written: there is no folder {folder.parent}")


def export_bag(
    config: EvalConfig,
    source: PolicySource,
    folder: Path,
    episode: int = 0,
    devices: Devices | None = None,
) -> dict[str, Any]:
    """Play one episode of an evaluation into a new bag; return what it holds.

    ``devices``: what topics, joints and frames are called, and how they count; None: as nubot's.
    """
    check_bag(folder)
    make = Messages(devices=devices or Devices())
    # What a policy perceived is stamped by the state that was sensed, not by the decision.
    watch, env = Watch(), FlipperEnv(config=config)
    seed = EvaluationSeeds.of(config.eval.seed, config.terrain)(episode)
    decided, sensed, ending = [], 0.0, None
    for decision in decisions(env, source.build(config), seed, observers=(watch,)):
        targets = make.angles(env.drive.targets)
        at = decision.transition.before.time
        decided.append(_Decided(at, sensed, decision.perception, decision.action, targets))
        sensed, ending = env.drive.delayed_state.time, decision.ending
    assert ending is not None  # decisions() yields until there is one

    # The bag, and what it holds by topic
    messages = list(_messages(make, watch, decided, config.perception))
    names = topic_names(make.devices)
    write_bag(folder, messages, make.devices)
    return {
        "format": "mcap",
        "output": str(folder),
        "terrain": env.profile.label,
        "seed": config.eval.seed,
        "outcome": ending["outcome"],
        "seconds": watch.states[-1].time,
        "messages": dict(Counter(names.get(s.topic, s.topic) for s in messages)),
    }


def topic_names(devices: Devices) -> dict[str, str]:
    """Return what the topics of the devices are called in a bag, by those of ``TYPES``."""
    called = devices.topics
    names = {CLOUD: called.clouds, IMU: called.imu, JOINT_STATES: called.joints}
    names |= {BELTS: called.belts, TARGETS: called.flipper_command}
    return {topic: f"/{name.lstrip('/')}" for topic, name in names.items()}


def write_bag(folder: Path, messages: Sequence[Stamped], devices: Devices | None = None) -> None:
    """Write messages of the topics in ``TYPES`` to a new bag, in the order of their times.

    Topics of devices are called as ``devices`` call them.
    """
    names = topic_names(devices or Devices())
    ros = require_rosbags("a bag")
    types, bag = typestore(), ros.rosbag2
    with (
        new_folder(folder) as inside,
        bag.Writer(inside, version=8, storage_plugin=bag.StoragePlugin.MCAP) as writer,
    ):
        # Each topic has its type's definition, which readers without ROS need.
        topics = {}
        for topic in dict.fromkeys(stamped.topic for stamped in messages):
            more = {"typestore": types, "offered_qos_profiles": _qos(topic)}
            name = names.get(topic, topic)
            topics[topic] = writer.add_connection(name, TYPES[topic], **more)
        for time, topic, message in sorted(messages, key=lambda stamped: stamped.time):
            data = types.serialize_cdr(message, TYPES[topic])
            writer.write(topics[topic], nanoseconds(time), data)


def _qos(topic: str) -> Sequence[Any]:
    """Return the profile with which players repeat the static frames for late subscribers."""
    if topic != STATIC:
        return ()
    from rosbags import interfaces as ros

    forever, liveliness = ros.QosTime(2**31 - 1, 0), ros.QosLiveliness.AUTOMATIC
    last, reliable = ros.QosHistory.KEEP_LAST, ros.QosReliability.RELIABLE
    local = ros.QosDurability.TRANSIENT_LOCAL
    timing = forever, forever, liveliness, forever
    return [ros.Qos(last, 1, reliable, local, *timing, avoid_ros_namespace_conventions=False)]


def _messages(
    make: Messages, watch: Watch, decided: Sequence[_Decided], sensor: Sensor
) -> Iterator[Stamped]:
    """Yield all messages; the truth stands in for what no instrument measures."""
    # Where scans are measured, if there are any
    kinds = {type(m.value) for m in watch.measurements}
    if Scan in kinds:
        if not all(hasattr(sensor, name) for name in _MOUNT):
            raise RequestError(
                f"perception: {sensor.plugin_name} does not say where its scans are measured; "
                f"the settings {', '.join(_MOUNT)} do"
            )
        yield Stamped(0.0, STATIC, make.mount(*(getattr(sensor, name) for name in _MOUNT)))

    # The truth at 100 Hz
    for state in watch.states:
        time = state.time
        yield Stamped(time, TRANSFORMS, make.transforms(state))
        yield Stamped(time, ODOMETRY, make.odometry(state))
        yield Stamped(time, JOINT_STATES, make.joint_state(time, *angles_of(state)))

    # What the policy perceived and did
    for decision in decided:
        numbers = decision.perception.observation.astype(np.float64)
        yield Stamped(decision.time, OBSERVATION, make.numbers(numbers))
        yield Stamped(decision.time, ACTION, make.number(decision.action))
        yield Stamped(decision.time, TARGETS, make.numbers(decision.targets))

    # Measurements, and the truth in place of an instrument that the robot lacks
    yield from _of_measurements(make, watch.measurements)
    if Inertial not in kinds:
        yield from (Stamped(s.time, IMU, _true_attitude(make, s)) for s in watch.states)
    if Scan not in kinds:
        yield from (
            Stamped(decision.sensed, CLOUD, _perceived_ground(make, decision))
            for decision in decided
        )


def _true_attitude(make: Messages, state: RobotState) -> Any:
    angles = state.roll, state.pitch, state.yaw
    rises = attitude(*angles)[2]  # of the axes
    lean = math.atan2(rises[1], rises[2])  # about which the y axis is turned from the level
    rates = 0.0, -state.pitch_rate * math.cos(lean), state.pitch_rate * math.sin(lean)
    return make.imu(state.time, angles, rates)


def _perceived_ground(make: Messages, decision: _Decided) -> Any:
    """Return the points that a sensor of the side plane saw, without those that fill gaps."""
    points, filled = decision.perception.points, decision.perception.filled
    points = points if filled is None else points[~filled]
    cloud = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    return make.cloud(decision.sensed, LEVEL, cloud)


def _of_measurements(make: Messages, measurements: Sequence[Measured]) -> Iterator[Stamped]:
    for measured in measurements:
        time, value = measured.time, measured.value
        if isinstance(value, Scan):
            yield Stamped(time, CLOUD, make.cloud(time, LIDAR, value.points, value.ages))
        elif isinstance(value, Inertial):
            x, y, z = (value.yaw_rate * attitude(value.roll, value.pitch, 0.0)[2]).tolist()
            yield Stamped(time, IMU, make.imu(time, (value.roll, value.pitch, 0.0), (x, y, z)))
        elif isinstance(value, Belts):
            yield Stamped(time, BELTS, make.number(value.speed / make.devices.belts.scale))
