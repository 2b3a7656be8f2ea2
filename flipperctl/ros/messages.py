"""Messages of ROS 2 with what the simulator knows, by the conventions of ROS.

In: states, scans and points in flipperctl's frames and signs. Out: messages of ``rosbags``.

REP-103: x ahead, y to the left, z up, and angles about these axes. So the front flippers are
positive *below* the chassis, the rear flippers above it, and a positive pitch is nose *down*. In
short, (front, rear, pitch) of ROS are (-front, +rear, -pitch) here. Frames (REP-105): ``odom`` is
the world; ``base_link`` is frame R, the chassis; ``base_stabilized`` is frame L, level at its
centre, turned by the heading; ``lidar`` is frame S.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, RobotState
from flipperctl.core.lidar.body import attitude, mounting
from flipperctl.errors import missing_extra
from flipperctl.runtime.devices import Devices

ODOM, BASE, LEVEL, LIDAR = "odom", "base_link", "base_stabilized", "lidar"
JOINTS = (
    "front_left_flipper",
    "front_right_flipper",
    "rear_left_flipper",
    "rear_right_flipper",
)
"""Joints in the order of all messages; ``export urdf`` has the same."""
TIME = "time"
"""Field of a cloud with the time of each point relative to the stamp [s]."""
EPOCH = 1_000_000_000
"""Stamp of an episode's start [s]; not 0, which in ROS means that there is no stamp."""
Place = tuple[float, float, float]
_NOT_MEASURED = -1.0
"""First number of a covariance whose quantity a message does not hold."""


def require_rosbags(what: str) -> ModuleType:
    """Return the package ``rosbags``; ``what`` needs it, and ``mcap``."""
    try:
        for name in ("mcap", "rosbags", "rosbags.rosbag2", "rosbags.typesys"):
            import_module(name)
    except ImportError as error:
        raise missing_extra(what, name.partition(".")[0]) from error
    return import_module("rosbags")


def typestore() -> Any:
    """Return the types of messages of ROS 2 Jazzy; those used here are the same since Humble."""
    types = require_rosbags("a bag").typesys
    return types.get_typestore(types.Stores.ROS2_JAZZY)


def nanoseconds(time: float) -> int:
    """Return the stamp of a time since the start of the episode [s] in nanoseconds."""
    return EPOCH * 10**9 + round(time * 1e9)


def quaternion(turn: FloatArray) -> tuple[float, float, float, float]:
    """Return x, y, z and w of a rotation matrix, (3, 3), with w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(turn).as_quat(canonical=True).tolist()
    return x, y, z, w


@dataclass(frozen=True)
class Messages:
    """Builds messages of the types of a distribution of ROS 2."""

    types: Any = field(default_factory=typestore)
    """``rosbags.typesys.Typestore``."""
    devices: Devices = field(default_factory=Devices)
    """What joints and frames are called, and how joints count."""
    origin: float = EPOCH
    """Stamp of the start of the episode [s]."""
    double: bool = False
    """Whether clouds have double precision, so that an episode on topics is that in process."""

    def header(self, time: float, frame: str) -> Any:
        """Return a header with the stamp of ``time`` since the start of the episode [s]."""
        return self._make("std_msgs/Header", stamp=self._stamp(time), frame_id=frame)

    def clock(self, time: float) -> Any:
        """Return a ``Clock``."""
        return self._make("rosgraph_msgs/Clock", clock=self._stamp(time))

    def _stamp(self, time: float) -> Any:
        seconds, rest = divmod(round(self.origin * 1e9) + round(time * 1e9), 10**9)
        return self._make("builtin_interfaces/Time", sec=seconds, nanosec=rest)

    def joint_state(self, time: float, *angles: float) -> Any:
        """Return the angles of J joints in frame R [rad] as a ``JointState``."""
        names = [
            name.lstrip("-") for name in (*self.devices.joints.front, *self.devices.joints.rear)
        ]
        content: dict[str, Any] = {"name": names, "position": self.angles(angles)}
        content |= {"velocity": np.empty(0), "effort": np.empty(0)}
        return self._make("sensor_msgs/JointState", header=self.header(time, self._base), **content)

    def angles(self, joints: Sequence[float]) -> FloatArray:
        """Return the angles of all flippers, as the robot counts them, by those of J joints [rad].

        Those of the joints are in frame R.
        """
        named, signs, half = self.devices.joints, self.devices.signs, len(joints) // 2
        ends = (named.front, signs.front, joints[:half]), (named.rear, signs.rear, joints[half:])
        # The flippers of a pair have one angle in common.
        angles = [
            (-angle if name.startswith("-") else angle) * sign / named.scale
            for names, sign, end in ends
            for name, angle in zip(names, itertools.cycle(end), strict=False)
        ]
        return np.array(angles) + 0.0  # no -0

    @property
    def _base(self) -> str:
        return self.devices.frames.base

    def imu(
        self,
        time: float,
        attitude_angles: tuple[float, float, float],
        rates: tuple[float, float, float],
    ) -> Any:
        """Return an ``Imu`` without acceleration.

        ``attitude_angles``: roll, pitch and heading [rad]; ``rates`` about x, y and z of ROS
        [rad/s].
        """
        # A covariance that begins with -1 says that there is no acceleration.
        unknown = np.zeros(9)
        unknown[0] = _NOT_MEASURED
        return self._make(
            "sensor_msgs/Imu",
            header=self.header(time, self._base),
            orientation=self._orientation(attitude(*attitude_angles)),
            orientation_covariance=np.zeros(9),
            angular_velocity=self._xyz("Vector3", *rates),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._xyz("Vector3", 0.0, 0.0, 0.0),
            linear_acceleration_covariance=unknown,
        )

    def odometry(self, state: RobotState) -> Any:
        """Return pose and velocity of the chassis centre; the velocity is in ``base_link``."""
        turn = attitude(state.roll, state.pitch, state.yaw)
        x, z = state.velocity.tolist()
        ahead = turn.T @ np.array([x, state.side_velocity, z])
        place, make = self._xyz("Point", *_place(state)), self._make
        pose = make("geometry_msgs/Pose", position=place, orientation=self._orientation(turn))
        linear = self._xyz("Vector3", *ahead.tolist())
        angular = self._xyz("Vector3", 0.0, -state.pitch_rate, 0.0)
        twist = make("geometry_msgs/Twist", linear=linear, angular=angular)
        none = np.zeros(36)
        return make(
            "nav_msgs/Odometry",
            header=self.header(state.time, self.devices.frames.fixed),
            child_frame_id=self._base,
            pose=make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=none),
            twist=make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=none),
        )

    def transforms(self, state: RobotState) -> Any:
        """Return the frames of the chassis, tilted and level, as a ``TFMessage``."""
        place, tilted = _place(state), attitude(state.roll, state.pitch, state.yaw)
        level = attitude(0.0, 0.0, state.yaw)
        turns = {self._base: (place, tilted), LEVEL: (place, level)}
        return self._frames(self.header(state.time, self.devices.frames.fixed), turns)

    def mount(self, x: float, z: float, axis: float) -> Any:
        """Return the place of the LiDAR on the chassis as a ``TFMessage``; see ``Mount``."""
        return self._frames(self.header(0.0, self._base), {LIDAR: ((x, 0.0, z), mounting(axis))})

    def cloud(
        self, time: float, frame: str, points: FloatArray, ages: FloatArray | None = None
    ) -> Any:
        """Return points, (P, 3) [m], as a ``PointCloud2``, of single precision by default.

        ``ages``: how long before ``time`` each was measured, (P,) [s]; they make a field ``time``
        of negative seconds relative to the stamp, as drivers of turning LiDARs write it.
        """
        names = "xyz" if ages is None else ("x", "y", "z", TIME)
        # Single precision and one time for each point, as drivers write them
        columns = points if ages is None else np.column_stack([points, -ages])
        size, kind = (8, 8) if self.double else (4, 7)
        fields = [
            self._make("sensor_msgs/PointField", name=name, offset=size * i, datatype=kind, count=1)
            for i, name in enumerate(names)
        ]
        data, step = np.ascontiguousarray(columns, f"<f{size}"), size * len(names)
        return self._make(
            "sensor_msgs/PointCloud2",
            header=self.header(time, frame),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=step,
            row_step=step * len(points),
            data=data.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def numbers(self, values: FloatArray) -> Any:
        """Return a ``Float64MultiArray`` of one dimension."""
        layout = self._make("std_msgs/MultiArrayLayout", dim=[], data_offset=0)
        data = np.asarray(values, np.float64)
        return self._make("std_msgs/Float64MultiArray", layout=layout, data=data)

    def number(self, value: float) -> Any:
        """Return a ``Float64``, or an ``Int32`` of an integer."""
        kind = "Float64" if isinstance(value, float) else "Int32"
        return self._make(f"std_msgs/{kind}", data=value)

    def _orientation(self, turn: FloatArray) -> Any:
        x, y, z, w = quaternion(turn)
        return self._make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def _xyz(self, kind: str, x: float, y: float, z: float) -> Any:
        return self._make(f"geometry_msgs/{kind}", x=x, y=y, z=z)

    def _frames(self, header: Any, turns: dict[str, tuple[Place, FloatArray]]) -> Any:
        """Return a ``TFMessage`` of the place and the rotation of each frame."""
        transforms = []
        for child, (place, turn) in turns.items():
            placed = {"translation": self._xyz("Vector3", *place)}
            placed |= {"rotation": self._orientation(turn)}
            content = {"child_frame_id": child}
            content["transform"] = self._make("geometry_msgs/Transform", **placed)
            kind = "geometry_msgs/TransformStamped"
            transforms.append(self._make(kind, header=header, **content))
        return self._make("tf2_msgs/TFMessage", transforms=transforms)

    def _make(self, name: str, /, **fields: Any) -> Any:
        return self.types.types[name.replace("/", "/msg/")](**fields)


def _place(state: RobotState) -> Place:
    x, z = state.position.tolist()
    return x, state.side, z
