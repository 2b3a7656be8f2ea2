"""Bags as robots write them: joints of an arm, transforms that come late, two LiDARs."""

import dataclasses
import math

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.ros.episode import TYPES, Stamped, write_bag
from flipperctl.ros.messages import JOINTS
from flipperctl.ros.perceiving import replay
from flipperctl.ros.recording import read_recording
from flipperctl.ros.topics import Names
from flipperctl.sim.lidar import LidarSensor
from tests.ros.driving import FRONT, HEIGHT, MOUNT, REAR, SECONDS, SPEED, driving, points

_EPOCH = 1_000_000_000
"""Seconds at which the bags of the simulator begin."""


def bag(folder, messages):
    write_bag(folder / "bag", sorted(messages, key=lambda one: one.time))
    return folder / "bag"


def replayed(source):
    return replay(source, LidarSensor(), Robot(), None, Names())


def test_the_place_of_a_lidar_may_be_known_later_than_its_first_cloud(tmp_path):
    def late():
        for one in driving():
            if one.topic == "/tf_static":  # as of a driver that publishes it with the others
                for stamp in np.arange(0.5, 2.0, 0.05).tolist():
                    yield Stamped(stamp, "/tf", _stamped(one.message, stamp))
            else:
                yield one

    recording = read_recording(bag(tmp_path, late()), Names())
    assert recording.mount.place == pytest.approx(MOUNT)


def _stamped(message, time):
    stamp = message.transforms[0].header.stamp
    stamp = dataclasses.replace(stamp, sec=_EPOCH + int(time), nanosec=round(1e9 * (time % 1)))
    found = [
        dataclasses.replace(one, header=dataclasses.replace(one.header, stamp=stamp))
        for one in message.transforms
    ]
    return dataclasses.replace(message, transforms=found)


def test_clouds_of_equal_stamps_are_counted_as_refused(tmp_path):
    messages = list(driving())
    second = [m._replace(time=m.time + 1e-4) for m in messages if m.topic == "/points"]
    summary = replayed(bag(tmp_path, [*messages, *second])).summary
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
    assert list(recording.joints) == topics
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
    assert "/imu/data is not used: it tells no orientation (it is level in" in recording.remarks[0]
