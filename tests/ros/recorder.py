"""A small recorder of topics, as ``ros2 bag record``: what a wire carries becomes a bag."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer

from flipperctl.ros.messages import typestore
from flipperctl.runtime.devices import Devices

OTHERS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def kinds(devices: Devices) -> dict[str, str]:
    """Topic → type of its messages, of a robot and its node."""
    topics = devices.topics
    ours = {
        topics.clouds: "sensor_msgs/msg/PointCloud2",
        topics.imu: "sensor_msgs/msg/Imu",
        topics.joints: "sensor_msgs/msg/JointState",
        topics.belts: "std_msgs/msg/Float64",
        topics.joint_command: "sensor_msgs/msg/JointState",
        topics.flipper_command: "std_msgs/msg/Float64MultiArray",
        topics.belts_may_run: "std_msgs/msg/Bool",
    }
    return {f"/{name.lstrip('/')}": kind for name, kind in ours.items()} | OTHERS


class Recorder:
    """Writes messages to a bag as they come."""

    def __init__(self, writer: Any, devices: Devices) -> None:
        self._writer, self._types, self.kinds = writer, typestore(), kinds(devices)
        self._topics: dict[str, Any] = {}
        self.counts: dict[str, int] = {}
        self._newest = 0.0  # stamp of all messages [s]

    def take(self, topic: str, message: Any) -> None:
        """Record a message as received at its stamp, or at the newest one if it has none."""
        stamp = getattr(getattr(message, "header", None), "stamp", getattr(message, "clock", None))
        if stamp is not None:
            time = stamp.sec + 1e-9 * stamp.nanosec
            self._newest = max(self._newest, time)
        self.write(topic, message, self._newest if stamp is None else time)

    def write(self, topic: str, message: Any, time: float) -> None:
        """Record a message of rosbags that was received at ``time`` [s]."""
        name = f"/{topic.lstrip('/')}"
        if (kind := self.kinds.get(name)) is None:
            return
        if name not in self._topics:
            self._topics[name] = self._writer.add_connection(name, kind, typestore=self._types)
        data = self._types.serialize_cdr(message, kind)
        self._writer.write(self._topics[name], round(time * 1e9), data)
        self.counts[name] = self.counts.get(name, 0) + 1

    def diagnosis(self, values: dict[str, str], time: float) -> None:
        """Record a message of our node with these values."""
        make = self._types.types
        stamp = make["builtin_interfaces/msg/Time"](sec=int(time), nanosec=0)
        header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        entry = make["diagnostic_msgs/msg/KeyValue"]
        status = make["diagnostic_msgs/msg/DiagnosticStatus"](
            level=0,
            name="flipperctl",
            message="",
            hardware_id="",
            values=[entry(key=key, value=value) for key, value in values.items()],
        )
        message = make["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
        self.write("/diagnostics", message, time)


@contextmanager
def recording(folder: Path, devices: Devices) -> Iterator[Recorder]:
    """Record until the end of the block."""
    with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        yield Recorder(writer, devices)
