"""Bags as robots write them: joints of an arm, transforms that come late, two LiDARs."""

import dataclasses
import math

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.bags.devices import read_recording
from flipperctl.bags.episode import Stamped, write_bag
from flipperctl.bags.perceiving import replay
from flipperctl.bags.topics import Names
from flipperctl.sim.lidar.sensor import LidarSensor
from tests.bags.driving import HEIGHT, MOUNT, SPEED, driving, points

_EPOCH = 1_000_000_000
"""Seconds at which the bags of the simulator begin."""


def bag(folder, messages):
    write_bag(folder / "bag", sorted(messages, key=lambda one: one.time))
    return folder / "bag"


def replayed(source):
    return replay(source, LidarSensor(), Robot(), None, Names())


def test_joints_of_an_arm_may_come_first(tmp_path):
    messages = list(driving())
    (first, *_) = (one for one in messages if one.topic == "/joint_states")
    arm = dataclasses.replace(first.message, name=["elbow"], position=np.zeros(1))
    arms = [one._replace(message=arm) for one in messages if one.topic == "/joint_states"]
    recording = read_recording(bag(tmp_path, [*arms, *messages]), Names())
    assert recording.remarks == []
    told = [s.messages["joints"] for s in recording.steps() if "joints" in s.messages]
    assert len(told) == len(arms)
    assert all(math.isfinite(one.front) for one in told)


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
