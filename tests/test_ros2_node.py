"""``examples/ros2``: the node on bags of ours, with a stand-in for rclpy; no middleware runs."""

import importlib.util
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from flipperctl.config import EvalConfig
from flipperctl.policies.source import PolicySource
from flipperctl.ros.episode import export_bag
from flipperctl.ros.messages import typestore
from tests.runtime.linear import ROBOT, RULE, write

FILE = Path(__file__).parents[1] / "examples" / "ros2" / "flipperctl_node.py"
Stream = list[tuple[float, str, Any]]


class Message(SimpleNamespace):
    """Any message: what it is given."""


class StandIn:
    """``rclpy.node.Node`` without middleware: what is published lies in ``published``."""

    parameters: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.published: dict[str, list[Any]] = {}
        self.warnings: list[str] = []
        self.time = 0.0

    def declare_parameter(self, name: str, default: Any) -> Any:
        return SimpleNamespace(value=self.parameters.get(name, default))

    def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
        self.callbacks[topic] = callback

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def create_timer(self, period: float, callback: Any) -> None:
        self.timer = callback

    def get_logger(self) -> Any:
        return SimpleNamespace(info=lambda text: None, warning=self.warnings.append)

    def create_service(self, kind: Any, name: str, callback: Any) -> None:
        self.callbacks[name] = callback

    def get_clock(self) -> Any:
        now = SimpleNamespace(nanoseconds=self.time * 1e9, to_msg=lambda: self.time)
        return SimpleNamespace(now=lambda: now)


class TransformException(Exception):  # noqa: N818  # its name in tf2_ros
    """No transform."""


class ExternalShutdownException(Exception):  # noqa: N818  # its name in rclpy
    """The context was shut down from outside, as by SIGTERM."""


class Buffer:
    """The static transforms of the bag."""

    static: ClassVar[dict[str, Any]] = {}

    def lookup_transform(self, target: str, source: str, time: Any) -> Any:
        if source not in self.static:
            raise TransformException(source)
        return self.static[source]


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Stream:
    """The messages of an episode with a LiDAR, in their order."""
    folder = tmp_path_factory.mktemp("bags") / "step"
    config = EvalConfig(
        terrain="step",
        perception={"name": "lidar", "pose": "belts", "azimuths": 60},
        episode={"run_up": 0.8, "run_out": 0.4},
    )
    export_bag(config, PolicySource(settings={"name": "okada"}), folder)
    types, found = typestore(), []
    with Reader(folder) as reader:
        for connection, time, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            found.append((time * 1e-9, connection.topic.lstrip("/"), message))
    return found[: len(found) // 3]


@pytest.fixture
def node(
    request: pytest.FixtureRequest,
    stream: Stream,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> Any:
    """A node with a policy whose action follows the heights, and further parameters."""
    file = write(tmp_path_factory.mktemp("policy") / "p.onnx", robot=ROBOT, targets=RULE)
    kinds = {
        "sensor_msgs": ("Imu", "JointState", "PointCloud2"),
        "std_msgs": ("Bool", "Float64", "Float64MultiArray", "Header"),
        "diagnostic_msgs": ("DiagnosticArray", "DiagnosticStatus", "KeyValue"),
    }
    modules = {f"{name}.msg": dict.fromkeys(found, Message) for name, found in kinds.items()}
    modules |= {name: {} for name in kinds}
    modules |= {
        "rclpy": {"time": SimpleNamespace(Time=lambda: None)},
        "rclpy.executors": {"ExternalShutdownException": ExternalShutdownException},
        "std_srvs": {},
        "std_srvs.srv": {"Trigger": Message},
        "rclpy.node": {"Node": StandIn},
        "rclpy.qos": {
            "QoSProfile": Message,
            "ReliabilityPolicy": SimpleNamespace(BEST_EFFORT=2),
            "qos_profile_sensor_data": None,
        },
        "tf2_ros": {
            "Buffer": Buffer,
            "TransformListener": lambda buffer, node: None,
            "TransformException": TransformException,
        },
    }
    for name, names in modules.items():
        module = ModuleType(name)
        module.__dict__.update(names)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(
        StandIn, "parameters", {"policy": str(file), **getattr(request, "param", {})}
    )
    statics = [m for _, topic, m in stream if topic == "tf_static"]
    frames = {t.child_frame_id: t for message in statics for t in message.transforms}
    monkeypatch.setattr(Buffer, "static", frames)
    spec = importlib.util.spec_from_file_location("flipperctl_node", FILE)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found.FlipperNode()


def play(node: Any, stream: Stream) -> list[tuple[float, str, str]]:
    """Hand over the messages; return time, level and text of each diagnosis."""
    told = node.published["/diagnostics"]
    found: list[tuple[float, str, str]] = []
    angles: dict[str, float] = {}
    commands = node.published["joint_command"]
    then = stream[0][0]
    for time, topic, message in stream:
        node.time = time
        for name, goal in zip(*_newest(commands), strict=True) if angles else ():
            most = 0.436 * (time - then)
            angles[name] += min(most, max(-most, goal - angles[name]))
        then = time
        if topic == "joint_states" and not node.shadow:  # flippers that obey
            for name, angle in zip(message.name, message.position, strict=False):
                angles.setdefault(name, angle)
            message = Message(**vars(message))
            message.position = [angles.get(name, 0.0) for name in message.name]
        if topic in node.callbacks:
            node.callbacks[topic](message)
        for one in told[len(found) :]:
            (status,) = one.status
            found.append((time, status.message, status.values[0].value))
    commands = node.published["flipper_controller/commands"]
    assert all(np.abs(c.data).max() <= math.pi / 3 + 1e-9 for c in commands)
    return found


def _newest(commands: list[Any]) -> tuple[list[str], list[float]]:
    """Return names and angles of the flippers of the newest command that has some."""
    for command in reversed(commands):
        if len(command.name) > 1:
            return command.name[:-1], command.position[:-1]
    return [], []


def faults(told: list[tuple[float, str, str]]) -> set[str]:
    return {fault for _, _, fault in told if fault}


def test_it_drives_an_episode_of_a_bag(node: Any, stream: Stream) -> None:
    told = play(node, stream)
    first = next(i for i, (_, text, _) in enumerate(told) if text == "driving")
    assert first < 3
    assert faults(told[first:]) == set()
    commands = np.array([c.data for c in node.published["flipper_controller/commands"]])
    assert len(np.unique(commands, axis=0)) > 2
    assert (commands[:, 0] == commands[:, 1]).all()
    assert node.published["belts_may_run"][first].data
    assert node.transform[1] == pytest.approx(np.eye(3), abs=1e-9)  # clouds come as measured


def jumps(stream: Stream) -> Stream:
    begun = stream[0][0]
    return [(t + (60 if t > begun + 1 else 0), topic, m) for t, topic, m in stream]


def changed(of: str, **changes: Any) -> Callable[[Stream], Stream]:
    """Return a function that changes fields of one topic's messages, or of their headers."""

    def apply(message: Any) -> Message:
        fields = vars(message) | changes
        header = {n: fields.pop(n) for n in ("stamp", "frame_id") if n in changes}
        return Message(**{**fields, "header": Message(**(vars(message.header) | header))})

    return lambda stream: [(t, n, apply(m) if n == of else m) for t, n, m in stream]


elsewhere = changed("points", frame_id="camera")
unstamped = changed("joint_states", stamp=Message(sec=0, nanosec=0))
without_orientation = changed("imu/data", orientation_covariance=[-1.0] + [0.0] * 8)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (jumps, "clock_jump"),
        (elsewhere, "cloud_frame"),
        (unstamped, "joints_value"),
        (without_orientation, "attitude_value"),
    ],
)
def test_a_bag_with_faults_is_refused_with_the_reason(
    node: Any, stream: Stream, change: Callable[..., Any], fault: str
) -> None:
    told = play(node, change(stream))
    assert fault in faults(told)
    assert all(text for _, text, name in told if name)
    assert not node.published["belts_may_run"][-1].data


def test_commands_and_diagnoses_have_a_stamp_and_a_stop_is_acknowledged(
    node: Any, stream: Stream
) -> None:
    play(node, jumps(stream))
    last = node.published["joint_command"][-1]
    assert (last.name[-1], last.velocity[-1]) == ("belts", 0.0)  # stopped by the clock
    stamps = [m.header.stamp for m in node.published["joint_command"]]
    assert stamps == [m.header.stamp for m in node.published["/diagnostics"]]
    assert stamps[-1] == pytest.approx(node.time, abs=0.05)
    response = node.callbacks["acknowledge"](None, Message())
    assert response.success
    play(node, [(t + 60, topic, m) for t, topic, m in stream[-20:]])
    assert node.published["/diagnostics"][-1].status[0].values[0].value != "clock_jump"


def test_a_shutdown_from_outside_is_no_error(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of SIGTERM, or of ros2 launch."""
    module = sys.modules["rclpy"]
    calls: list[str] = []

    def spin(node: Any) -> None:
        raise ExternalShutdownException

    for name in ("init", "try_shutdown"):
        monkeypatch.setattr(module, name, lambda name=name: calls.append(name), raising=False)
    monkeypatch.setattr(module, "spin", spin, raising=False)
    type(node).begin.__globals__["main"]()
    assert calls == ["init", "try_shutdown"]


@pytest.mark.parametrize("node", [{"shadow": True}], indirect=True)
def test_shadow_mode_commands_nothing(node: Any, stream: Stream) -> None:
    told = play(node, stream)
    assert [text for _, text, _ in told[3:]] == ["driving"] * len(told[3:])
    assert node.published["flipper_controller/commands"] == []
    assert node.published["belts_may_run"] == []


def split(stream: Stream) -> Iterator[tuple[float, str, Any]]:
    """Each pair of flippers has messages of its own."""
    for time, topic, message in stream:
        if topic == "joint_states":
            for half in (slice(0, 2), slice(2, 4)):
                part = {"name": message.name[half], "position": message.position[half]}
                yield time, topic, Message(**{**vars(message), **part})
        else:
            yield time, topic, message
