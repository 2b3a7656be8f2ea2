"""Prints what a robot's topics say as lines of JSON, as the self-test reads them.

    ros2 run flipperctl_ros messages --ros-args -p devices:=robot.yaml |
        python -m flipperctl.runtime --self-test - devices=robot.yaml

Joints and belts keep the names, signs and units of their topics. Clouds are thinned, one in 0.5 s.
An Imu keeps its frame: one that is not frames.base is turned by the node alone, which knows tf. The
self-test refuses it and names the frame.
"""

import json
import sys
from pathlib import Path

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState, PointCloud2
from std_msgs.msg import Float64

from flipperctl.errors import FlipperctlError
from flipperctl.runtime import Attitude, read_devices
from flipperctl.runtime.point_cloud import read_cloud
from flipperctl_ros import spin_until_stopped

MOST, EVERY = 2000, 0.5  # points of a cloud; time between two clouds [s]


class Lines(Node):
    """Writes a line for each message of a device."""

    def __init__(self, **options):
        super().__init__("flipperctl_messages", **options)
        file = Path(self.declare_parameter("devices", "robot.yaml").value)
        kind = self.declare_parameter("belts_type", "Float64").value
        self.devices, self.last = read_devices(file), 0.0
        names, qos = self.devices.topics, qos_profile_sensor_data
        belts = Odometry if kind == "Odometry" else Float64
        subscribe = self.create_subscription
        subscribe(PointCloud2, names.clouds, self.on_cloud, qos)
        subscribe(Imu, names.imu, self.on_imu, qos)
        subscribe(JointState, names.joints, self.on_joints, qos)
        subscribe(belts, names.belts, self.on_belts, qos)

    def write(self, device, content):
        """Print a message; its time is that at which it came, by the node's clock [s]."""
        line = {"time": self.get_clock().now().nanoseconds * 1e-9, device: content}
        print(json.dumps(line), flush=True)

    def on_joints(self, message):
        self.write("joints", dict(zip(message.name, message.position, strict=False)))

    def on_belts(self, message):
        twist = getattr(message, "twist", None)
        speed = message.data if twist is None else twist.twist.linear.x
        self.write("odometry", {"speed": speed})

    def on_imu(self, message):
        q, rates, frame = message.orientation, message.angular_velocity, message.header.frame_id
        about = rates.x, rates.y, rates.z
        attitude = Attitude.from_imu(0.0, frame.lstrip("/"), (q.x, q.y, q.z, q.w), about)
        names = "frame", "roll", "pitch", "yaw_rate"
        self.write("attitude", {name: getattr(attitude, name) for name in names})

    def on_cloud(self, message):
        now = self.get_clock().now().nanoseconds * 1e-9
        if 0 <= now - self.last < EVERY:
            return
        self.last = now
        points, _ = read_cloud(message)
        # A place that the file tells is that of any frame; otherwise clouds come in the chassis.
        frame = message.header.frame_id if self.devices.mount is None else "lidar"
        points = points[:: 1 + len(points) // MOST]
        self.write("cloud", {"frame": frame.lstrip("/"), "points": points.tolist()})


def main():
    """Print lines until the reader or the user ends it."""
    try:
        spin_until_stopped(Lines)
    except FlipperctlError as error:
        sys.exit(f"error: {error}")
    except BrokenPipeError:
        pass


if __name__ == "__main__":
    main()
