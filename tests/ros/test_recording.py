"""Recordings as robots write them, and what a policy would have done on one (``robot shadow``)."""

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from flipperctl.api import Robot
from flipperctl.config import EvalConfig
from flipperctl.policies.source import PolicySource
from flipperctl.ros.episode import ACTION, TYPES, export_bag, write_bag
from flipperctl.ros.messages import JOINTS, typestore
from flipperctl.ros.perceiving import replay
from flipperctl.ros.recording import LOG, read_recording
from flipperctl.ros.topics import Names
from flipperctl.sim.lidar import LidarSensor
from flipperctl.text.files import check_output
from tests.cli.call import call
from tests.ros.driving import FRONT, HEIGHT, MOUNT, REAR, SECONDS, SPEED, driving, points
from tests.runtime.linear import ROBOT, RULE, write

_EPOCH = 1_000_000_000
"""Seconds at which the bags of the simulator begin."""


def replayed(source):
    return replay(source, LidarSensor(), Robot(), None, Names())


def test_the_place_of_a_lidar_may_be_known_later_than_its_first_cloud(tmp_path):
    def late(topic, message):
        if topic == "/tf":  # as of a driver that publishes it with the others, half a second later
            stamp = message.transforms[0].header.stamp
            if stamp.sec + 1e-9 * stamp.nanosec >= _EPOCH + 0.5:
                yield topic, _stamped(mount, stamp)
        if topic != "/tf_static":
            yield topic, message

    mount = next(driving()).message
    assert recorded(tmp_path, late).mount.place == pytest.approx(MOUNT)


def _stamped(message, stamp):
    (one,) = message.transforms
    header = dataclasses.replace(one.header, stamp=stamp)
    return dataclasses.replace(message, transforms=[dataclasses.replace(one, header=header)])


def test_clouds_of_equal_stamps_are_counted_as_refused(tmp_path):
    messages = list(driving())
    second = [m._replace(time=m.time + 1e-4) for m in messages if m.topic == "/points"]
    write_bag(tmp_path / "bag", [*messages, *second])
    summary = replayed(tmp_path / "bag").summary
    assert summary["scans"] == len(second)
    assert summary["refused"]["cloud_older"]["count"] == len(second)


def test_a_folder_is_in_the_order_of_its_numbers_and_its_map_may_begin_anywhere(tmp_path):
    cos, sin = math.cos(-0.8), math.sin(-0.8)
    turn = np.array([[sin, 0, cos], [0, 1, 0], [-cos, 0, sin]])
    rows = []
    for index in range(13):
        time = 0.1 * index
        np.save(tmp_path / f"cloud_{index}.npy", points(time) @ turn.T + MOUNT)
        east, north = 5e5, 5.5e6 + SPEED * time  # it drives north
        rows.append([time, east, north, 300.1, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    np.savetxt(tmp_path / "poses.txt", rows, fmt="%.9f")
    found = replayed(tmp_path)
    assert found.summary["refused"] == {}
    heights = found.instants[-1].ground.heights
    assert heights[:8] == pytest.approx([-0.1] * 8, abs=0.01)
    assert heights[-1] == pytest.approx(HEIGHT - 0.1, abs=0.01)


def recorded(tmp_path, change):
    """The recording of a drive whose messages are changed: topic and message → those instead."""
    messages = []
    for one in driving():
        for topic, message in change(one.topic, one.message):
            messages.append(one._replace(topic=topic, message=message))
    write_bag(tmp_path / "bag", messages)
    return read_recording(tmp_path / "bag", Names())


def joints_in_parts(topic, message, each, names=JOINTS):
    """Yield the joints of some names, ``each`` a message, on topics that the function returns."""
    if topic != "/joint_states":
        yield topic, message
        return
    for at in range(0, len(names), each):
        part = [*message.name].index(names[at])
        some = slice(part, part + each)
        told = dataclasses.replace(
            message, name=message.name[some], position=message.position[some]
        )
        yield topic, told


@pytest.mark.parametrize("several", [False, True])
def test_joints_may_come_in_parts_after_an_arm_and_on_several_topics(
    tmp_path, monkeypatch, several
):
    for name in JOINTS:
        monkeypatch.setitem(TYPES, f"/{name}", TYPES["/joint_states"])

    def change(topic, message):
        if topic == "/joint_states":
            yield topic, dataclasses.replace(message, name=["elbow"], position=np.zeros(1))
        for where, part in joints_in_parts(topic, message, 1 if several else 2):
            own = several and where == "/joint_states"
            yield (f"/{part.name[0]}" if own else where), part

    recording = recorded(tmp_path, change)
    assert recording.remarks == []
    topics = [f"/{name}" for name in JOINTS] if several else ["/joint_states"]
    assert list(recording.used.joints) == topics
    told = [s.messages["joints"] for s in recording.steps() if "joints" in s.messages]
    assert [told[-1].front, told[-1].rear] == pytest.approx([-FRONT, REAR])
    assert told[-1].time == pytest.approx(_EPOCH + SECONDS)


def test_a_joint_that_is_missing_is_named(tmp_path):
    recording = recorded(tmp_path, lambda *one: joints_in_parts(*one, 1, JOINTS[:3]))
    assert recording.remarks == [
        "no JointState has the joint rear_right_flipper, only front_left_flipper, "
        "front_right_flipper, rear_left_flipper: the flippers are taken for level"
    ]


def test_an_orientation_that_is_never_filled_in_is_not_used(tmp_path):
    def change(topic, message):
        if topic == "/imu/data":
            rates = dataclasses.replace(message.angular_velocity, y=0.2)
            message = dataclasses.replace(message, angular_velocity=rates)
        yield topic, message

    recording = recorded(tmp_path, change)
    assert "attitude" not in recording.topics
    assert "/imu/data: change of tilt, attitude against turn rates: 0.268" in recording.remarks[0]
    assert recording.remarks[0].endswith("the device is not used")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A policy, a recording, and one whose clouds end after a second."""
    folder = tmp_path_factory.mktemp("shadow")
    write(folder / "p.onnx", robot=ROBOT, targets=RULE)
    messages = list(driving())
    write_bag(folder / "drive", messages)
    write_bag(folder / "blind", [m for m in messages if m.topic != "/points" or m.time < 1])
    return folder


def test_the_log_says_what_the_policy_would_have_done(folder):
    done = call("robot", "shadow", "p.onnx", "drive", "--output", "log.jsonl", "--json", cwd=folder)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["decisions"] == sum(found["actions"].values()) == 4  # at 0, 0.6 … 1.8 s
    assert found["faults"] == {}
    assert found["states"] == {"driving": pytest.approx(SECONDS)}
    check_output(folder / "log.jsonl", LOG)  # a log of before is replaced
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    decided = [line for line in lines if line["action"] is not None]
    assert len(decided) == found["decisions"]
    assert decided[1]["time"] - decided[0]["time"] == pytest.approx(0.6)
    for line in decided:
        assert line["measured"] == pytest.approx([-FRONT, REAR])  # in the signs of ROS
        assert max(map(abs, line["targets"])) <= math.pi / 3 + 1e-9
        assert line["drive"] is True


def test_what_a_robot_would_refuse_is_in_the_log_with_the_reason(folder):
    done = call("robot", "shadow", "p.onnx", "blind", "--output", "blind.jsonl", cwd=folder)
    assert done.code == 0, done.err
    assert re.search(r"cloud is 0\.5\d s old; at most 0\.5 s is allowed", done.out)
    lines = [json.loads(line) for line in (folder / "blind.jsonl").read_text().splitlines()]
    assert [line["fault"] for line in lines if line["state"] == "holding"] == ["cloud_age"]
    assert lines[-1]["reason"].endswith("at most 0.5 s is allowed")


def test_an_episode_s_own_policy_proposes_what_it_did(folder):
    file = str(folder / "p.onnx")
    config = EvalConfig(
        terrain="step",
        perception={"name": "lidar", "pose": "belts", "azimuths": 60},
        episode={"run_up": 1.0, "run_out": 0.2},
    )
    export_bag(config, PolicySource(Path(file)), folder / "own")
    done = call("robot", "shadow", file, "own", "--output", "own.jsonl", cwd=folder)
    assert done.code == 0, done.err
    lines = [json.loads(line) for line in (folder / "own.jsonl").read_text().splitlines()]
    proposed = [line["action"] for line in lines if line["action"] is not None]
    types, did = typestore(), []
    with Reader(folder / "own") as reader:
        (actions,) = [c for c in reader.connections if c.topic == ACTION]
        for _, _, data in reader.messages(connections=[actions]):
            did.append(types.deserialize_cdr(data, actions.msgtype).data)
    assert proposed[: len(did)] == did
    assert len(set(did)) > 1


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["p.onnx", "drive", "robot=absolem"], "robot: the policy's file states the robot"),
        (["p.onnx", "drive", "perception.half_width=0.6"], "the settings of its map, which are"),
        (["p.onnx", "drive", "perception.pose=true"], "no robot knows this; belts or matched"),
    ],
)
def test_a_wrong_request_is_one_error(folder, words, error):
    done = call("robot", "shadow", *words, "--output", "wrong.jsonl", cwd=folder)
    assert (done.code, done.out) == (2, "")
    assert error in done.err
    assert not (folder / "wrong.jsonl").exists()
