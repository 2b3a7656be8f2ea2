"""Episodes as bags of ROS 2, read again by rosbags and by mcap."""

import math
import sys
from collections import defaultdict

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader

from flipperctl.api import RobotState
from flipperctl.config import EvalConfig
from flipperctl.core.lidar.body import mounting
from flipperctl.core.lidar.messages import Belts, Inertial, Scan
from flipperctl.core.sensing import Measured
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import MissingExtraError, OutputError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros import episode
from flipperctl.ros.episode import Stamped, Watch, export_bag, write_bag
from flipperctl.ros.messages import EPOCH, Messages, nanoseconds, quaternion, typestore
from tests.cli.call import call

CONFIG = EvalConfig(terrain="step", episode={"run_up": 0.8, "run_out": 0.4})
OKADA = PolicySource(settings={"name": "okada"})


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "step"
    return folder, export_bag(CONFIG, OKADA, folder)


@pytest.fixture(scope="module")
def played():
    """The same episode, played again."""
    watch, env = Watch(), FlipperEnv(config=CONFIG)
    seed = EvaluationSeeds.of(0, CONFIG.terrain)(0)
    made = list(decisions(env, OKADA.build(CONFIG), seed, observers=(watch,)))
    return watch.states, made


def by_rosbags(folder):
    types, found = typestore(), defaultdict(list)
    with Reader(folder) as reader:
        for connection, time, data in reader.messages():
            found[connection.topic].append((time, types.deserialize_cdr(data, connection.msgtype)))
    return found


def by_mcap(folder):
    found = defaultdict(list)
    with (folder / f"{folder.name}.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic].append((message.log_time, decoded))
    return found


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_two_readers_find_the_numbers_of_the_episode(bag, played, read):
    folder, summary = bag
    states, made = played
    found = read(folder)
    assert {topic: len(messages) for topic, messages in found.items()} == summary["messages"]
    assert len(found["/joint_states"]) == len(states)
    for state, (time, joints) in zip(states, found["/joint_states"], strict=True):
        assert time == nanoseconds(state.time)
        angles = [-state.front, -state.front, state.rear, state.rear]
        assert list(joints.position) == angles
    for state, (_, odometry) in zip(states, found["/odom"], strict=True):
        place = odometry.pose.pose.position
        assert [place.x, place.z] == state.position.tolist()
        turn = odometry.pose.pose.orientation
        assert turn.y == pytest.approx(-math.sin(state.pitch / 2), abs=1e-12)  # nose down
    numbers = zip(found["/flipperctl/observation"], found["/flipperctl/action"], strict=True)
    for decision, ((_, observation), (_, action)) in zip(made, numbers, strict=True):
        assert list(observation.data) == decision.perception.observation.tolist()
        assert action.data == decision.action
    for decision, (_, cloud) in zip(made, found["/points"], strict=True):
        assert cloud.header.frame_id == "base_stabilized"
        x, y, z = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3).T
        points = decision.perception.points.astype(np.float32)
        assert (np.column_stack([x, z]) == points).all()
        assert not y.any()
    targets = np.array([list(message.data) for _, message in found["/flipper_controller/commands"]])
    assert (targets[:, 0] == targets[:, 1]).all()
    turned = np.diff(np.vstack([np.zeros(4), targets]), axis=0)[:, 2]
    rear = [d.transition.action[1] * CONFIG.robot.angle_step for d in made]
    assert turned == pytest.approx(rear)  # no rear flipper is blocked on this ground


def test_the_signs_and_stamps_are_those_of_ros():
    make = Messages()
    joints = make.joint_state(1.25, 0.2, 0.3)
    assert joints.position.tolist() == [-0.2, -0.2, 0.3, 0.3]
    assert (joints.header.stamp.sec, joints.header.stamp.nanosec) == (EPOCH + 1, 250_000_000)
    state = RobotState(
        np.array([1.0, 0.5]), 0.4, 0, 0, np.array([math.cos(0.4), math.sin(0.4)]), 0.1, 2.0, yaw=0
    )
    odometry = make.odometry(state)
    assert odometry.pose.pose.orientation.y == pytest.approx(-math.sin(0.2))
    assert odometry.twist.twist.linear.x == pytest.approx(1)  # along the chassis
    assert odometry.twist.twist.angular.y == pytest.approx(-0.1)
    tilted, level = make.transforms(state).transforms
    assert (tilted.child_frame_id, level.child_frame_id) == ("base_link", "base_stabilized")
    assert level.transform.rotation.w == 1
    imu = make.imu(0.0, (0.2, 0.0, 0.0), (0, 0, 0))
    assert imu.orientation.x == pytest.approx(math.sin(0.1))  # left side up
    assert imu.linear_acceleration_covariance[0] == -1  # not measured


@pytest.mark.parametrize("axis", [math.pi / 4, -math.pi / 2])
def test_the_mount_of_a_lidar_is_its_rotation(axis):
    (mount,) = Messages().mount(0.25, 0.4, axis).transforms
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "lidar")
    x, y, z, w = (getattr(mount.transform.rotation, name) for name in "xyzw")
    up = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    assert up == pytest.approx(mounting(axis)[:, 2])
    assert quaternion(np.eye(3)) == (0, 0, 0, 1)


def test_measurements_of_a_lidar_take_the_place_of_the_truth():
    cloud = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    measured = [
        Measured("scan", 0.1, Scan(cloud, np.array([0.08, 0.0]))),
        Measured("inertial", 0.2, Inertial(roll=0.0, pitch=0.2, yaw_rate=0.3)),
        Measured("belts", 0.3, Belts(0.19)),
    ]
    scan, imu, belts = episode._of_measurements(Messages(), measured)
    assert scan.message.header.frame_id == "lidar"
    assert scan.message.width == 2
    assert [field.name for field in scan.message.fields] == ["x", "y", "z", "time"]
    rows = scan.message.data.view("<f4").reshape(2, 4)
    assert rows.tolist() == pytest.approx(np.array([[1, 2, 3, -0.08], [4, 5, 6, 0]]))
    assert imu.message.orientation.y == pytest.approx(-math.sin(0.1))
    rates = imu.message.angular_velocity  # about the axes of a chassis that is nose up
    expected = 0.3 * math.sin(0.2), 0.0, 0.3 * math.cos(0.2)
    assert (rates.x, rates.y, rates.z) == pytest.approx(expected)
    assert belts == Stamped(0.3, "/belt_speed", belts.message)
    assert belts.message.data == 0.19


def test_the_command_refuses_what_it_cannot_write(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    done = call("export", "mcap", "terrain=flat", "--output", "there", cwd=tmp_path)
    assert done.code == 2
    assert "there cannot be written: a bag is a new folder" in done.err
    with pytest.raises(OutputError, match="there is no folder"):
        export_bag(CONFIG, OKADA, tmp_path / "absent/bag")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[ros\]'"):
        write_bag(tmp_path / "bag", [])
