"""A robot's node without middleware, on bags of ours."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from flipperctl.config import EvalConfig
from flipperctl.errors import PolicyError
from flipperctl.policies.source import PolicySource
from flipperctl.ros.episode import export_bag
from flipperctl.ros.messages import typestore
from flipperctl.runtime.devices import Devices, devices_of
from flipperctl.runtime.markers import markers_of
from flipperctl.runtime.node import Command, Diagnosis, Place, RobotNode
from tests.runtime.linear import RISK, ROBOT, RULE, write

Stream = list[tuple[float, str, Any]]
DEVICES = Devices()
FLIPPERS = (*DEVICES.joints.front, *DEVICES.joints.rear)


class Message(SimpleNamespace):
    """Any message: what it is given."""


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
    types, messages = typestore(), []
    with Reader(folder) as reader:
        for connection, time, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            messages.append((time * 1e-9, connection.topic.lstrip("/"), message))
    return messages[: len(messages) // 3]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy whose action follows the heights."""
    return write(tmp_path_factory.mktemp("policy") / "p.onnx", robot=ROBOT, targets=RULE)


class Driver:
    """A shell around a node: hands over messages, obeys commands and keeps what was said."""

    def __init__(self, file: Path, stream: Stream, devices: Devices = DEVICES, **options: Any):
        statics = [m for _, topic, m in stream if topic == "tf_static"]
        self.places = {t.child_frame_id: t.transform for m in statics for t in m.transforms}
        self.warnings: list[str] = []
        self.node = RobotNode(file, devices, self.place, warn=self.warnings.append, **options)
        self.commands: list[Command] = []
        self.told: list[tuple[float, Diagnosis]] = []
        self.angles: dict[str, float] = {}
        self.then = stream[0][0]

    def place(self, frame: str) -> Place | None:
        if frame not in self.places:
            return None
        t, q = self.places[frame].translation, self.places[frame].rotation
        return Place(t.x, t.y, t.z, (q.x, q.y, q.z, q.w))

    def play(self, stream: Stream) -> "Driver":
        node, topics = self.node, self.node.devices.topics
        take = {topics.clouds: node.cloud, topics.joints: node.joints, topics.belts: node.belts}
        for time, topic, message in stream:
            if topic == topics.joints:
                message = self.moved(time, message)
            if topic in take:
                take[topic](time, message)
            elif topic == topics.imu:
                command, diagnosis = node.step(time, node.imu(time, message))
                self.told.append((time, diagnosis))
                self.commands += [command] if command is not None else []
        return self

    def moved(self, time: float, message: Any) -> Any:
        """Return angles of flippers that obey the newest command."""
        newest = next((c for c in reversed(self.commands) if c.flippers), None)
        most, self.then = 0.436 * (time - self.then), time
        for name, angle in zip(message.name, message.position, strict=False):
            self.angles.setdefault(name, angle)
        for name, goal in zip(newest.names, newest.flippers, strict=False) if newest else ():
            self.angles[name] += min(most, max(-most, goal - self.angles[name]))
        message = Message(**vars(message))
        message.position = [self.angles[name] for name in message.name]
        return message

    @property
    def faults(self) -> set[str]:
        return {d.values["fault"] for _, d in self.told if d.values["fault"]}

    @property
    def states(self) -> list[str]:
        return [d.values["state"] for _, d in self.told]


def test_it_drives_an_episode_of_a_bag(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream).play(stream)
    first = driver.states.index("driving")
    assert first < 3
    assert driver.faults <= {"joints_missing", "cloud_missing", "attitude_missing"}
    assert {"driving"} == set(driver.states[first:])
    turned = [c for c in driver.commands if c.flippers]
    assert len({c.flippers for c in turned}) > 2
    assert all(c.names == (*FLIPPERS, "belts") for c in turned)
    assert all(c.flippers[0] == c.flippers[1] for c in turned)
    assert all(max(map(abs, c.flippers)) <= math.pi / 3 + 1e-9 for c in turned)
    last = driver.commands[-1]
    assert (last.drive, last.source, last.speeds[-1]) == (True, "policy", ROBOT["track_speed"])
    assert last.time == driver.told[-1][0]
    assert last.valid_for == DEVICES.limits.valid_for


def test_other_names_units_and_signs_of_a_devices_file_give_the_same_drive(
    file: Path, stream: Stream
) -> None:
    joints = {"front": ["-fl", "fr"], "rear": ["rl", "-rr"], "signs": "flipperctl"}
    joints["scale"] = math.radians(1)
    place = {"x": 0.25, "z": 0.4, "axis": -math.pi / 4}
    settings = {"joints": joints, "belts": {"scale": 0.001}, "lidar": place}
    factors = dict(zip(("fl", "fr", "rl", "rr"), (1, -1, 1, -1), strict=True))

    def renamed(topic: str, message: Any) -> Any:
        if topic == "joint_states":
            pairs = zip(message.position, factors.values(), strict=True)
            position = [math.degrees(angle) * factor for angle, factor in pairs]
            return Message(**{**vars(message), "name": [*factors], "position": position})
        if topic == "belt_speed":
            return Message(data=1000 * message.data)
        return message

    driver, few = Driver(file, stream, devices_of(settings, "test")), stream[: len(stream) // 2]
    driver.places.clear()  # the file tells the place
    driver.moved = lambda time, message: message  # type: ignore[method-assign]
    plain = Driver(file, stream)
    plain.moved = lambda time, message: message  # type: ignore[method-assign]
    plain.play(few)
    driver.play([(t, n, renamed(n, m)) for t, n, m in few])
    assert plain.states == driver.states
    assert "driving" in plain.states
    for a, b in zip(plain.commands, driver.commands, strict=True):
        back = [f * math.radians(v) for f, v in zip(factors.values(), b.flippers, strict=False)]
        assert back == pytest.approx(list(a.flippers), abs=1e-9)


def test_an_arm_and_a_second_lidar_do_not_disturb_it(file: Path, stream: Stream) -> None:
    few = stream[: len(stream) // 3]
    driver, both = Driver(file, stream), []
    driver.places["camera"] = driver.places["lidar"]
    for part in zip(few, elsewhere(few), strict=True):
        both += part if part[0][1] == "points" else part[:1]
        if part[0][1] == "joint_states":
            arm = {**vars(part[0][2]), "name": ["elbow"], "position": np.zeros(1)}
            driver.angles["elbow"] = 0.0
            both.append((part[0][0], "joint_states", Message(**arm)))
    driver.play(both)
    assert "driving" in driver.states[:6]
    assert set(driver.warnings) == {"clouds come in lidar and in camera"}


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
    file: Path, stream: Stream, change: Callable[..., Any], fault: str
) -> None:
    driver = Driver(file, stream).play(change(stream))
    assert fault in driver.faults
    assert all(d.message != d.values["state"] for _, d in driver.told if d.values["fault"])
    assert not driver.commands[-1].drive


def test_a_stop_is_acknowledged(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream).play(jumps(stream))
    assert (driver.commands[-1].names[-1], driver.commands[-1].speeds[-1]) == ("belts", 0.0)
    assert driver.node.acknowledge() == "acknowledged"
    driver.play([(t + 60, topic, m) for t, topic, m in stream[-20:]])
    assert driver.told[-1][1].values["fault"] != "clock_jump"


def test_shadow_mode_commands_nothing(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream, shadow=True)
    driver.node.enabled = False  # as no one commands, this changes nothing
    driver.play(stream)
    assert set(driver.states[3:]) == {"driving"}
    assert driver.commands == []


def test_an_operator_takes_over_and_hands_back(file: Path, stream: Stream) -> None:
    driver, third = Driver(file, stream), len(stream) // 3
    driver.play(stream[:third])
    assert driver.commands[-1].source == "policy"
    before = dict(driver.angles)
    pad = DEVICES.operator
    buttons, axes = [0] * 8, [0.0] * 8
    buttons[pad.deadman], axes[pad.belts], axes[pad.front] = 1, -0.5, 1.0
    for entry in stream[third : 2 * third]:
        driver.node.joy(entry[0], Message(buttons=buttons, axes=axes))
        driver.play([entry])
    taken = driver.commands[-1]
    assert (taken.source, driver.told[-1][1].values["commands"]) == ("operator", "operator")
    assert taken.speeds[-1] == pytest.approx(-0.5 * ROBOT["track_speed"])
    # Up is negative for the front pair by REP-103; the rear pair stays.
    assert taken.flippers[0] < before[FLIPPERS[0]] - 0.3
    assert taken.flippers[2] == pytest.approx(before[FLIPPERS[2]], abs=0.02)
    assert driver.states[-1] == "standby"
    driver.node.joy(stream[2 * third][0], Message(buttons=[0] * 8, axes=[0.0] * 8))
    driver.play(stream[2 * third :])
    assert (driver.commands[-1].source, driver.states[-1]) == ("policy", "driving")


def test_an_operator_whose_radio_ends_commands_no_more(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream).play(stream[:200])
    buttons = [0] * 8
    buttons[DEVICES.operator.deadman] = 1
    driver.node.joy(stream[199][0], Message(buttons=buttons, axes=[0.0] * 8))
    driver.play(stream[200:])
    sources = [c.source for c in driver.commands]
    assert "operator" in sources
    assert sources[-1] == "policy"


def test_a_stop_by_hand_lasts_until_it_is_acknowledged(file: Path, stream: Stream) -> None:
    driver, half = Driver(file, stream), len(stream) // 2
    driver.play(stream[:half])
    driver.node.press_stop(pressed=True)
    driver.node.joy(0.0, Message(buttons=[0] * 8, axes=[0.0] * 8))  # another button, not pressed
    assert driver.node.acknowledge() == "the emergency stop is still pressed"
    driver.node.press_stop(pressed=False)
    driver.play(stream[half : half + 60])
    last = driver.commands[-1]
    assert (last.drive, last.flippers, last.source) == (False, (), "nobody")
    assert driver.told[-1][1].values["fault"] == "stop_by_hand"
    driver.node.acknowledge()
    driver.play(stream[half + 60 :])
    assert driver.commands[-1].source == "policy"


def test_a_node_that_is_not_enabled_commands_nothing(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream)
    driver.node.enabled = False
    driver.play(stream)
    assert {(c.drive, c.flippers, c.source) for c in driver.commands} == {(False, (), "nobody")}
    assert driver.told[-1][1].message == "the policy is not enabled"


def test_markers_show_what_it_perceives_and_plans(tmp_path: Path, stream: Stream) -> None:
    file = write(tmp_path / "r.onnx", robot=ROBOT, targets=RULE, risky=True, risk=RISK)
    driver = Driver(file, stream).play(stream)
    turned = next(c for c in reversed(driver.commands) if c.flippers)
    drawn = {marker.name: marker for marker in markers_of(driver.node, turned)}
    assert set(drawn) == {"map", "heights", "unseen", "plan", "risk"}
    interface = driver.node.controller.policy.interface
    assert len(drawn["heights"].points) + len(drawn["unseen"].points) == interface.bins
    hinge, tip = drawn["plan"].points[:2]
    angle = -turned.flippers[0]  # by REP-103
    length = ROBOT["flipper_length"] - ROBOT["track_radius"]
    assert tip - hinge == pytest.approx([length * math.cos(angle), 0, length * math.sin(angle)])
    assert drawn["risk"].text.startswith("risk 0.")


def split(stream: Stream) -> Iterator[tuple[float, str, Any]]:
    """Each pair of flippers has messages of its own."""
    for time, topic, message in stream:
        if topic == "joint_states":
            for half in (slice(0, 2), slice(2, 4)):
                part = {"name": message.name[half], "position": message.position[half]}
                yield time, topic, Message(**{**vars(message), **part})
        else:
            yield time, topic, message


def test_joints_in_parts_are_taken(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream).play(list(split(stream[: len(stream) // 3])))
    first = driver.states.index("driving")
    assert first < 3
    assert set(driver.states[first:]) == {"driving"}
    assert driver.warnings == []


def test_devices_that_are_silent_or_misnamed_are_told(file: Path, stream: Stream) -> None:
    settings = {"joints": {"front": ["front_left_flipper", "fr"]}}
    driver = Driver(file, stream, devices_of(settings, "test"))
    driver.play([entry for entry in stream if entry[1] != "belt_speed"])
    assert "joint_states tells no angle of the joints fr" in driver.warnings
    assert any(text.startswith("no speed of the belts has come") for text in driver.warnings)


def test_a_cloud_without_coordinates_is_told(file: Path, stream: Stream) -> None:
    driver = Driver(file, stream)
    message = next(m for _, topic, m in stream if topic == "points")
    driver.node.cloud(0.0, Message(**{**vars(message), "fields": message.fields[1:]}))
    assert "a cloud needs x, y and z as floats" in driver.warnings[0]


@pytest.mark.parametrize("where", ["file", "policy"])
def test_devices_come_from_a_file_or_with_the_policy(
    where: str, tmp_path: Path, stream: Stream
) -> None:
    devices = devices_of({"topics": {"clouds": "front/points"}, "overall_width": 0.9}, "test")
    more = {"devices": devices.to_json()} if where == "policy" else {}
    file = write(tmp_path / "d.onnx", robot=ROBOT, targets=RULE, **more)
    node = RobotNode(file, None if where == "policy" else devices)
    assert node.devices == devices


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"joints": {"fornt": ["a"]}}, "joints.fornt: there is no such key (did you mean 'front'?"),
        ({"joints": {"front": "fl"}}, "joints.front is 'fl'; a list of names is allowed"),
        ({"lidar": {"x": 1}}, "x, z and axis are allowed together"),
        ({"lidar": {"x": "1e-1"}}, "lidar.x is '1e-1'; a finite number or null is allowed"),
        ({"overall_width": 0.1}, "more than chassis_width"),
        ({"operator": {"stop": 1.5}}, "operator.stop is 1.5; a whole number"),
        ({"limits": {"tilt": -1}}, "limits: tilt is -1"),
        ({"pose": True}, "pose is True; belts or matched is allowed"),
        ({"joints": {"scale": 0}}, "scale is 0"),
        (3, "devices is 3; a mapping"),
    ],
)
def test_wrong_settings_of_devices_are_named(settings: Any, text: str) -> None:
    with pytest.raises(PolicyError) as error:
        devices_of(settings, "mine.yaml")
    assert str(error.value).startswith("mine.yaml: ")
    assert text in str(error.value)
