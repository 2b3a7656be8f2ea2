"""A lifecycle node of ROS 2 around ``flipperctl.runtime.node``, which decides what is published.

    ros2 run flipperctl_ros node --ros-args -p policy:=stair.onnx -p devices:=robot.yaml

``configure`` reads policy and devices and listens; only an ``active`` node commands. With the
parameter ``autostart`` (true by default) it does both by itself. The policy commands once the
service ``enable`` says so, so that a node that was started again moves nothing. All names, frames,
units and limits are those of the devices file; remaps and a namespace work as usual.
"""

import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import Imu, JointState, Joy, PointCloud2
from std_msgs.msg import Bool, ColorRGBA, Float64, Float64MultiArray, Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from flipperctl.errors import FlipperctlError
from flipperctl.runtime.devices import read_devices
from flipperctl.runtime.lockstep import Lockstep
from flipperctl.runtime.markers import markers_of
from flipperctl.runtime.node import Place, RobotNode
from flipperctl_ros import spin_until_stopped

LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}
KINDS = {"plan": Marker.LINE_LIST, "risk": Marker.TEXT_VIEW_FACING}  # the others are points
BELTS = {"Float64": Float64, "Odometry": Odometry}
OF_ROS = {"use_sim_time", "start_type_description_service"}
PARAMETERS = {
    "policy": ("policy.onnx", "an exported policy"),
    "devices": ("", "the robot's devices, a file; empty: the policy's own, or nubot's"),
    "enabled": (False, "whether the policy commands before the service enable says so"),
    "shadow": (False, "whether nothing is commanded"),
    "escape": (False, "whether a policy that warns draws its actions"),
    "belts_type": ("Float64", "type of the belts' speed: Float64 or Odometry"),
    "lockstep": (False, "whether a simulated robot waits for each answer"),
    "autostart": (True, "whether the node configures and activates itself"),
}
PERIOD = 0.05  # of steps without messages, since age is a fault [s]
DISCOVERY, NEW = 2.0, 10.0  # in which another node is seen; is the newer one of two [s]
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def newest(depth):
    """Return the quality of a subscription to the last messages, of any publisher."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


class FlipperNode(LifecycleNode):
    """Hands messages to a ``RobotNode``, and publishes what it answers."""

    def __init__(self, **options):
        declare = {"automatically_declare_parameters_from_overrides": True}
        super().__init__("flipperctl", **declare, **options)
        # A misspelt parameter, as of shadow, must not move the robot.
        given = set(self.get_parameters_by_prefix("")) - set(PARAMETERS) - OF_ROS
        self.unknown = {name for name in given if "." not in name}
        for name, (default, _) in PARAMETERS.items():
            if not self.has_parameter(name):
                self.declare_parameter(name, default)
        self.robot, self.lockstep, self.commands, self.ours = None, None, {}, []
        self.buffer = None  # of tf

    def parameter(self, name):
        return self.get_parameter(name).value

    # Transitions

    def on_configure(self, state):
        """Read the policy and the devices, and listen; nothing is commanded yet."""
        log = self.get_logger()
        if self.unknown:
            log.error(f"there are no parameters {', '.join(sorted(self.unknown))}")
            return FAILURE
        if self.parameter("belts_type") not in BELTS:
            log.error(f"belts_type: {' or '.join(BELTS)} is allowed")
            return FAILURE
        try:
            file = self.parameter("devices")
            self.robot = RobotNode(
                self.parameter("policy"),
                read_devices(Path(file)) if file else None,
                self.place_of,
                shadow=self.parameter("shadow"),
                escape=self.parameter("escape"),
                trusted=self.parameter("lockstep"),  # which no real robot answers
                log=log.info,
                warn=log.warning,
            )
        except FlipperctlError as error:
            log.error(str(error))
            return FAILURE
        self.robot.enabled, self.episode = False, None
        self.enabled = self.parameter("enabled")  # then what the service says
        self.lockstep = Lockstep(self.robot) if self.parameter("lockstep") else None
        if self.robot.devices.mount is None and not self.listens_to_tf():
            log.error("tf2_ros is missing; give the place of the LiDAR in the devices file")
            return FAILURE
        names, lockstep = self.robot.devices.topics, self.lockstep is not None
        belts = BELTS[self.parameter("belts_type")]
        # A busy node takes the newest messages; joints may come one in a message.
        flippers = len(self.robot.devices.joints.front + self.robot.devices.joints.rear)
        depth = 1000 if lockstep else 10
        qos = (qos_profile_sensor_data, newest(1), newest(flippers), newest(1))
        qos = (depth,) * 4 if lockstep else qos
        subscribe, take, robot = self.create_subscription, self.take, self.robot
        self.ours = [
            subscribe(PointCloud2, names.clouds, take("cloud", robot.cloud), qos[0]),
            subscribe(Imu, names.imu, take("imu", self.on_imu), qos[1]),
            subscribe(JointState, names.joints, take("joints", robot.joints), qos[2]),
            subscribe(belts, names.belts, take("belts", robot.belts), qos[3]),
            subscribe(Joy, names.joy, lambda message: robot.joy(self.now(), message), 10),
            subscribe(Bool, "stop", lambda message: robot.press_stop(message.data), 10),
            subscribe(Float64, "simulation/begin", self.begin, 10),
            subscribe(Float64MultiArray, "simulation/tick", self.on_tick, depth),
        ]
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.ready = self.create_publisher(Float64, "simulation/ready", 10)
        self.pictures = self.create_publisher(MarkerArray, "~/markers", 1)
        self.services_of = [
            self.create_service(Trigger, "acknowledge", self.on_acknowledge),
            self.create_service(Trigger, "reset", self.on_reset),
            self.create_service(SetBool, "enable", self.on_enable),
        ]
        self.timers_of = [self.create_timer(1.0, self.watch)]
        if not lockstep:
            self.timers_of.append(self.create_timer(PERIOD, self.step))
        return SUCCESS

    def on_activate(self, state):
        """Command, unless another node commands this robot."""
        names = self.robot.devices.topics
        if self.parameter("shadow"):
            return super().on_activate(state)
        until = time.monotonic() + DISCOVERY
        while time.monotonic() < until:
            if self.count_publishers(names.joint_command):
                self.get_logger().error(f"another node commands {names.joint_command}; refused")
                return FAILURE
            time.sleep(0.1)
        self.commands = {
            "joints": self.create_publisher(JointState, names.joint_command, 10),
            "flippers": self.create_publisher(Float64MultiArray, names.flipper_command, 10),
            "belts": self.create_publisher(Bool, names.belts_may_run, 10),
        }
        self.robot.enabled, self.since, self.seen = self.enabled, time.monotonic(), None
        self.get_logger().info(f"active: commands {names.joint_command}")
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Command no more; the last command expires."""
        self.stop_commanding()
        return super().on_deactivate(state)

    def on_cleanup(self, state):
        """Listen no more."""
        self.close()
        return SUCCESS

    def on_shutdown(self, state):
        """Close what was opened."""
        self.close()
        return SUCCESS

    def stop_commanding(self):
        self.robot.enabled = False
        for publisher in self.commands.values():
            self.destroy_publisher(publisher)
        self.commands = {}

    def close(self):
        if self.robot is None:
            return
        self.stop_commanding()
        for timer in self.timers_of:
            self.destroy_timer(timer)
        for service in self.services_of:
            self.destroy_service(service)
        for subscription in self.ours:
            self.destroy_subscription(subscription)
        for publisher in (self.diagnostics, self.ready, self.pictures):
            self.destroy_publisher(publisher)
        self.robot, self.ours = None, []

    # Messages

    def now(self):
        """Return the node's clock [s]; it must be that of the stamps."""
        return self.get_clock().now().nanoseconds * 1e-9

    def take(self, device, function):
        """Return the callback of a device; in lockstep its messages wait for their tick."""

        def callback(message):
            if self.lockstep is not None:
                self.answer(self.lockstep.take(device, message))
            else:
                function(self.now(), message)

        return callback

    def on_imu(self, now, message):
        """Step with each attitude: it moves the pose on."""
        self.step(self.robot.imu(now, message))

    def on_tick(self, tick):
        """Step once all messages of a sample of the simulated robot are there."""
        if self.lockstep is not None:
            self.time = tick.data[0]
            self.answer(self.lockstep.tick(*tick.data))

    def answer(self, answer):
        """Publish what a sample was answered, if it was complete."""
        if answer is not None:
            self.publish(self.time, *answer)

    def begin(self, message):
        """Begin anew with an episode of a simulated robot, and say so."""
        if message.data != self.episode:  # it is repeated until the answer has arrived
            self.episode = message.data
            self.robot.reset(since=message.data)
            if self.lockstep is not None:
                self.lockstep.begin()
        self.ready.publish(message)

    def step(self, attitude=None):
        now = self.now()
        self.publish(now, *self.robot.step(now, attitude))

    def publish(self, now, command, diagnosis):
        """Publish a command, if this node may, and the diagnosis."""
        stamp = Time(nanoseconds=round(now * 1e9)).to_msg()
        header = Header(stamp=stamp, frame_id=self.robot.devices.frames.base)
        if command is not None and self.commands:
            names, angles = list(command.names), list(command.angles)
            if command.flippers:
                flippers = Float64MultiArray(data=list(command.flippers))
                self.commands["flippers"].publish(flippers)
            self.commands["belts"].publish(Bool(data=command.drive))
            self.commands["joints"].publish(
                JointState(
                    header=header, name=names, position=angles, velocity=list(command.speeds)
                )
            )
        told = {**diagnosis.values, "processor": f"{time.process_time():.3f}"}  # used so far [s]
        values = [KeyValue(key=key, value=value) for key, value in told.items()]
        status = DiagnosticStatus(
            level=LEVELS[diagnosis.level],
            name="flipperctl",
            message=diagnosis.message,
            values=values,
        )
        self.diagnostics.publish(DiagnosticArray(header=header, status=[status]))
        if self.pictures.get_subscription_count():
            markers = [self.marker(header, m) for m in markers_of(self.robot, command)]
            self.pictures.publish(MarkerArray(markers=markers))

    def marker(self, header, drawn):
        marker = Marker(header=header, ns=drawn.name, text=drawn.text)
        marker.type = KINDS.get(drawn.name, Marker.POINTS)
        marker.scale.x = marker.scale.y = marker.scale.z = 0.1 if drawn.text else 0.03
        red, green, blue = drawn.colour
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        points = [Point(x=x, y=y, z=z) for x, y, z in drawn.points.tolist()]
        if drawn.text:
            marker.pose.position = points[0]
        else:
            marker.points = points
        marker.pose.orientation.w = 1.0
        return marker

    def watch(self):
        """Stop if another node commands, too: the newer one at once, the older one if it must."""
        name, now = self.robot.devices.topics.joint_command, time.monotonic()
        if not self.commands or self.count_publishers(name) < 2:
            self.seen = None
            return
        self.seen = self.seen or now
        if now - self.since < NEW or now - self.seen > NEW:
            self.get_logger().error(f"another node commands {name}: this one stops")
            self.stop_commanding()

    # Services

    def on_acknowledge(self, request, response):
        """Let the robot go on after a stop that lasts."""
        response.message = self.robot.acknowledge()
        response.success = response.message == "acknowledged"
        return response

    def on_reset(self, request, response):
        """Begin anew on level ground, as after the robot was carried."""
        self.robot.reset(self.now())
        response.success, response.message = True, "the map is empty"
        return response

    def on_enable(self, request, response):
        """Let the policy command, or not; an operator may at any time."""
        self.enabled = request.data
        self.robot.enabled = self.enabled and bool(self.commands)
        response.success, response.message = True, "enabled" if self.enabled else "disabled"
        return response

    # Transforms

    def listens_to_tf(self):
        """Return whether tf2_ros is there, and listen."""
        try:
            from tf2_ros import Buffer, TransformListener
        except ImportError:
            return False
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        return True

    def place_of(self, frame):
        """Return where a sensor is on the chassis; None as long as tf does not know it."""
        if self.buffer is None and not self.listens_to_tf():
            return None
        from tf2_ros import TransformException

        base = self.robot.devices.frames.base
        try:
            at = self.buffer.lookup_transform(base, frame, Time()).transform
        except TransformException:
            return None
        t, q = at.translation, at.rotation
        return Place(t.x, t.y, t.z, (q.x, q.y, q.z, q.w))


def usage():
    """Return how the node is started, and its parameters with their defaults."""
    about = __doc__.replace("``", "")
    rows = [f"  {name} ({value!r}): {text}" for name, (value, text) in PARAMETERS.items()]
    return "\n".join([about, "Parameters, with their defaults:", *rows])


def main():
    """Run the node until it is stopped."""
    if {"-h", "--help"} & {*sys.argv[1:]}:
        print(usage())
        return
    if not spin_until_stopped(started):
        sys.exit(1)  # its log says why


def started():
    """Return the node, configured and active if it starts by itself; None if it cannot."""
    node = FlipperNode()
    if not node.parameter("autostart"):
        return node
    active = node.trigger_configure() == SUCCESS and node.trigger_activate() == SUCCESS
    return node if active else None


if __name__ == "__main__":
    main()
