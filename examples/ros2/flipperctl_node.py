"""A ROS 2 node around ``FlipperController``: from the topics of a robot to targets of its flippers.

It needs rclpy, the standard messages and ``flipperctl`` (which needs numpy and onnxruntime alone):

    python flipperctl_node.py --ros-args -p policy:=stair.onnx

In: ``points`` (PointCloud2), ``imu/data`` (Imu), ``joint_states`` (JointState of the four flippers)
and ``belt_speed`` (Float64, optional). Out: ``joint_command`` (JointState, with a stamp: the angles
of the flippers, and the largest speed of the belts), ``flipper_controller/commands``
(Float64MultiArray, as forward_command_controller takes it), ``belts_may_run`` (Bool) and
``/diagnostics``. A command counts for 0.3 s: after that whoever drives the motors stops them. The
place of the LiDAR comes from tf. After a stop that lasts, call the service ``acknowledge``.

With ``-p shadow:=true`` nothing is commanded: the log shows what would be. With ``-p escape:=true``
actions are drawn on a warning, as in the simulator.
"""

import math
from dataclasses import replace

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState, PointCloud2
from std_msgs.msg import Bool, Float64, Float64MultiArray, Header
from std_srvs.srv import Trigger
from tf2_ros import Buffer, TransformException, TransformListener

from flipperctl.runtime import (
    REP_103,
    Attitude,
    Cloud,
    FlipperController,
    Mount,
    NewestJoints,
    Odometry,
    PointTimes,
    RobotSetup,
    read_cloud,
)

BASE = "base_link"
FRONT = ("front_left_flipper", "front_right_flipper")
REAR = ("rear_left_flipper", "rear_right_flipper")
BELTS = "belts"
MOUNT = Mount(
    x=0.0, z=0.0, axis=math.pi / 2, near=0.1, margin=0.05
)  # of clouds that come in base_link
OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"
LEVELS = {"standby": OK, "driving": OK, "waiting": WARN, "holding": WARN, "stopped": ERROR}


def seconds(stamp):
    """Return a stamp as one number [s]; NaN without a stamp, which the controller refuses."""
    return stamp.sec + 1e-9 * stamp.nanosec if stamp.sec or stamp.nanosec else math.nan


def rotation(q):
    """Return the rotation matrix of a quaternion, (3, 3)."""
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


class FlipperNode(Node):
    """Hands every message to the controller, and its answer to the flippers."""

    def __init__(self):
        super().__init__("flipperctl")
        self.pose = self.declare_parameter("pose", "belts").value
        self.policy = self.declare_parameter("policy", "policy.onnx").value
        self.shadow = self.declare_parameter("shadow", False).value
        self.escape = self.declare_parameter("escape", False).value
        self.begin(MOUNT)
        self.cloud = self.joints = self.odometry = self.transform = None
        self.times, self.newest, self.warned = PointTimes(), NewestJoints(FRONT, REAR), set()
        self.tf = Buffer()
        self.listener = TransformListener(self.tf, self)
        self.create_subscription(PointCloud2, "points", self.on_cloud, qos_profile_sensor_data)
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Imu, "imu/data", self.on_imu, best_effort)
        self.create_subscription(JointState, "joint_states", self.on_joints, 10)
        self.create_subscription(Float64, "belt_speed", self.on_belts, 10)
        self.commands = self.create_publisher(Float64MultiArray, "flipper_controller/commands", 10)
        self.stamped = self.create_publisher(JointState, "joint_command", 10)
        self.may_run = self.create_publisher(Bool, "belts_may_run", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Trigger, "acknowledge", self.on_acknowledge)
        self.create_timer(0.05, self.step)  # without messages too: age is a fault

    def begin(self, mount):
        """Begin with a LiDAR at this place."""
        setup = RobotSetup(REP_103, cloud_frame=BASE, attitude_frame=BASE, mount=mount)
        setup, log = replace(setup, pose=self.pose), self.get_logger().info
        options = {"shadow": self.shadow, "escape": self.escape}
        self.controller = FlipperController(self.policy, setup, log=log, **options)
        self.speed = float(self.controller.policy.interface.robot.get("track_speed", math.nan))

    def now(self):
        """Return the node's clock [s]; it must be that of the stamps."""
        return self.get_clock().now().nanoseconds * 1e-9

    def on_cloud(self, message):
        """Move a cloud to where its mount says; one of an unknown frame goes on and is refused.

        There is one LiDAR: clouds of several come merged, in the frame of the chassis.
        """
        frame, stamp = message.header.frame_id, seconds(message.header.stamp)
        if self.transform is not None and self.transform[0] != frame:
            self.get_logger().warning(f"clouds come in {self.transform[0]} and in {frame}")
            return
        try:
            points, times = read_cloud(message)
        except ValueError as error:
            self.get_logger().warning(str(error))
            return
        self.times.add(times, stamp, self.now())
        shifts, ages = self.times.shifts(times, stamp), None
        for text in {*self.times.remarks()} - self.warned:
            self.get_logger().warning(text)
            self.warned.add(text)
        if frame != BASE and self.place_of(frame):
            turn, place = self.transform[1:]
            points, frame = points @ turn.T + place, BASE
        if shifts is not None:  # drivers stamp either end of a turn, we the last
            end = max(0.0, float(np.nanmax(shifts)))
            stamp, ages = stamp + end, end - shifts
        self.cloud = Cloud(stamp, frame, points, ages)

    def place_of(self, frame):
        """Return whether tf knows the place of the device, which is fixed to the chassis."""
        if self.transform is None:
            try:
                found = self.tf.lookup_transform(BASE, frame, rclpy.time.Time()).transform
            except TransformException as error:
                self.get_logger().warning(f"no transform from {frame} to {BASE}: {error}")
                return False
            place, turn = found.translation, rotation(found.rotation)
            axis = math.atan2(turn[2, 2], turn[0, 2])  # about which it turns: rings stay rings
            mount = replace(MOUNT, x=place.x, z=place.z, axis=axis)
            self.begin(mount)
            back = mount.turn.T
            self.transform = frame, back @ turn, back @ (0.0, place.y, 0.0)
        return True

    def on_joints(self, message):
        """Take the angles of the flippers, all or a part; other joints are not ours."""
        stamp = seconds(message.header.stamp)
        self.joints = self.newest.take(stamp, message.name, message.position) or self.joints

    def on_belts(self, message):
        """Take the speed of the belts; the message has no stamp of its own."""
        self.odometry = Odometry(self.now(), message.data)

    def on_imu(self, message):
        """Step with each attitude: it moves the pose on."""
        time, q = seconds(message.header.stamp), message.orientation
        w = math.nan if message.orientation_covariance[0] < 0 else q.w  # it tells no orientation
        rates, frame = message.angular_velocity, message.header.frame_id
        turn = rates.x, rates.y, rates.z
        a, push = message.linear_acceleration, None
        if message.linear_acceleration_covariance[0] >= 0:
            push = a.x, a.y, a.z
        self.step(Attitude.from_imu(time, frame, (q.x, q.y, q.z, w), turn, push))

    def on_acknowledge(self, request, response):
        """Let the robot go on after a stop that lasts."""
        self.controller.acknowledge()
        response.success, response.message = True, "acknowledged"
        return response

    def step(self, attitude=None):
        """Hand over what has arrived, and publish the answer."""
        answer = self.controller.step(self.now(), self.cloud, attitude, self.joints, self.odometry)
        self.cloud = self.joints = self.odometry = None
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=BASE)
        if not self.shadow:
            self.command(header, answer)
        values = [KeyValue(key="fault", value=answer.fault)]
        status = DiagnosticStatus(
            level=LEVELS[answer.state],
            name="flipperctl",
            message=answer.reason or answer.state,
            values=values,
        )
        self.diagnostics.publish(DiagnosticArray(header=header, status=[status]))

    def command(self, header, answer):
        """Publish what the motors may do; flippers that get no command are left out."""
        names, angles = [BELTS], [math.nan]
        if answer.targets is not None:
            front, rear = answer.targets
            names, angles = [*FRONT, *REAR, BELTS], [front, front, rear, rear, math.nan]
            self.commands.publish(Float64MultiArray(data=angles[:-1]))
        speeds = [math.nan] * (len(names) - 1) + [self.speed if answer.drive else 0.0]
        self.stamped.publish(
            JointState(header=header, name=names, position=angles, velocity=speeds)
        )
        self.may_run.publish(Bool(data=answer.drive))


def main():
    """Run the node until it is stopped."""
    rclpy.init()
    try:
        rclpy.spin(FlipperNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # Ctrl-C, or the end that ros2 launch asks for
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
