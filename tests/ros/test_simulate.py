"""The simulated robot on topics and the robot's node, joined in this process."""

import itertools
import math
import time
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flipperctl.commands.robot import recorded_robot
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros import simulate
from flipperctl.ros.simulate import Link, TopicRobot
from flipperctl.runtime.devices import Devices, devices_of
from flipperctl.runtime.lockstep import Lockstep
from flipperctl.runtime.node import RobotNode
from tests.cli.call import call
from tests.runtime.linear import FOUR, RATES, ROBOT, RULE, SIDES, write

SCENE = ("terrain=paper_step", "sim=mujoco", "perception.azimuths=60")
DECISIONS = 24  # until the robot is on the step
PLACE = {"x": 0.25, "z": 0.4, "axis": -math.pi / 4}
OTHER = {
    "lidar": PLACE,
    "topics": {"clouds": "front/points", "joint_command": "legs"},
    "joints": {"front": ["-fl", "fr"], "rear": ["rl", "-rr"], "scale": math.radians(1)},
    "belts": {"scale": 0.001},
    "frames": {"base": "chassis"},
}


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy")
    assert call("export", "onnx", "generalist", "--output", "p.onnx", cwd=folder).code == 0
    return folder / "p.onnx"


class Joined:
    """A wire whose other end is a node, which answers at once."""

    def __init__(self, node: RobotNode | None) -> None:
        self.node, self.receivers = node, {}
        topics = (node.devices if node is not None else Devices()).topics
        self.devices = {
            topics.clouds: "cloud",
            topics.imu: "imu",
            topics.joints: "joints",
            topics.belts: "belts",
        }
        self.command = topics.joint_command
        self.lockstep = Lockstep(node) if node is not None else None

    def publisher(self, topic: str, kind: str, **quality: bool) -> Any:
        return lambda message: self.sent(topic, message)

    def subscribe(self, topic: str, kind: str, receive: Any) -> None:
        self.receivers[topic] = receive

    def close(self) -> None: ...

    def sent(self, topic: str, message: Any) -> None:
        if self.lockstep is None:
            return
        answer = None
        if topic in self.devices:
            answer = self.lockstep.take(self.devices[topic], message)
        elif topic == "simulation/tick":
            answer = self.lockstep.tick(*message.data)
        elif topic == "simulation/begin":
            self.lockstep.begin()
            self.receivers["simulation/ready"](message)
        if answer is not None:
            self.obey(answer[0])

    def obey(self, command: Any) -> None:
        seconds = math.floor(command.time)
        rest = round((command.time - seconds) * 1e9)
        header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=rest))
        joints = {"name": command.names, "position": command.angles, "velocity": command.speeds}
        self.receivers[self.command](SimpleNamespace(header=header, **joints))


def scene(devices: Devices) -> EvalConfig:
    return recorded_robot(SCENE, devices).config


def driven(config: EvalConfig, devices: Devices, policy: Path, episode: int) -> list[Any]:
    node = RobotNode(policy, devices, escape=True, trusted=True)
    robot = TopicRobot(Joined(node), devices, config, Link(lockstep=True))
    robot.prepare(episode)
    return targets(config, robot, episode, robot)


def targets(config: EvalConfig, driver: Any, episode: int, *observers: Any) -> list[Any]:
    env, seeds = FlipperEnv(config=config), EvaluationSeeds.of(config.eval.seed, config.terrain)
    played = islice(decisions(env, driver, seeds(episode), observers=observers), DECISIONS)
    return [[round(float(angle), 6) for angle in env.drive.targets] for _ in played]


@pytest.mark.parametrize("settings", [{"lidar": PLACE}, OTHER], ids=["usual", "other"])
def test_an_episode_in_lockstep_has_the_targets_of_the_one_in_process(
    policy: Path, settings: dict[str, Any]
) -> None:
    """Also where topics, joints, frames, signs and units are those of another robot."""
    devices = devices_of(settings, "test")
    config = scene(devices)
    source = load_policy(policy)
    for episode in (0, 1):
        alone = targets(config, source.build(config), episode)
        assert len({tuple(pair) for pair in alone}) > 3
        assert driven(config, devices, policy, episode) == alone


def test_a_policy_with_sides_has_the_same_targets_on_topics(tmp_path: Path) -> None:
    # Its rates are two heights ahead on the left.
    policy = write(tmp_path / "sides.onnx", **SIDES | RATES | {"first": 39, "scale": 3.0})
    devices = devices_of({"lidar": PLACE}, "test")
    config = recorded_robot((*SCENE, "sim.one_sided=1", "perception.sides=true"), devices).config
    # Until a pair is held, which one side's load turns away
    alone = targets(config, load_policy(policy).build(config), 0)[:12]
    assert np.ptp(alone) > 0.5
    assert driven(config, devices, policy, 0)[:12] == alone


def test_four_flippers_have_the_same_targets_on_topics(tmp_path: Path) -> None:
    policy = write(tmp_path / "four.onnx", **FOUR, robot=ROBOT, targets=RULE)
    devices = devices_of({"lidar": PLACE}, "test")
    config = recorded_robot((*SCENE, "robot.flippers=four"), devices).config
    # Until a flipper is held, which its load turns away
    alone = targets(config, load_policy(policy).build(config), 0)[:12]
    assert np.shape(alone) == (12, 4)
    assert np.ptp(alone, axis=1).max() > 0.5
    assert driven(config, devices, policy, 0)[:12] == alone


def test_motors_without_a_command_stand(policy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    devices = devices_of({"lidar": PLACE}, "test")
    config = scene(devices)
    node = RobotNode(policy, devices, trusted=True)
    robot = TopicRobot(Joined(node), devices, config, Link(lockstep=True))
    robot.prepare(0)
    env, seeds = FlipperEnv(config=config), EvaluationSeeds.of(config.eval.seed, config.terrain)
    ways = []
    for number, _ in enumerate(decisions(env, robot, seeds(0), observers=(robot,))):
        ways.append(float(env.state.position[0]))
        if number == 3:  # the node dies: its answers come, but no motor hears them
            monkeypatch.setattr(robot, "_watch", simulate.CommandWatch())
            monkeypatch.setattr(robot._watch, "take", lambda *a: None)
        if number == 9:
            break
    assert ways[3] - ways[0] > 0.2
    assert ways[-1] - ways[5] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("angles", "text"),
    [
        ([0.2, 0.2, 0.1, 0.1], None),
        ([0.2, -0.2, 0.1, 0.1], "joint_command turns the joints front_left_flipper, front_right"),
        ([0.2], "joint_command has angles of a part of the joints front_left_flipper, front_r"),
        ([], None),
    ],
)
def test_commands_that_turn_a_pair_apart_are_told(angles: list[float], text: str | None) -> None:
    devices, told = devices_of({"lidar": PLACE}, "test"), []
    wire = Joined(None)
    TopicRobot(wire, devices, scene(devices), Link(), told.append)
    names = [*devices.joints.front, *devices.joints.rear][: len(angles)]
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0))
    message = SimpleNamespace(
        header=header,
        name=[*names, "belts"],
        position=[*angles, math.nan],
        velocity=[*(math.nan for _ in names), 0.2],
    )
    for _ in range(2):
        wire.receivers["joint_command"](message)
    assert len(told) == (0 if text is None else 1)
    assert all(line.startswith(text) for line in told)


def test_a_clock_that_steps_changes_stamps_alone(policy: Path) -> None:
    devices = devices_of({"lidar": PLACE}, "test")
    config, wire, stamps = scene(devices), Joined(None), []
    link = Link(rate=50.0, clock_step=(0.5, -5.0))
    robot = TopicRobot(wire, devices, config, link)
    wire.sent = lambda topic, message: (  # type: ignore[method-assign]
        stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
        if topic == devices.topics.joints
        else None
    )
    env = FlipperEnv(config=config)
    for number, _ in enumerate(decisions(env, robot, 5, observers=(robot,))):
        if number == 1:
            break
    steps = [round(after - before, 6) for before, after in itertools.pairwise(stamps)]
    assert steps.count(-4.99) == 1
    assert set(steps) == {-4.99, 0.01}
    assert stamps[0] - min(stamps) == pytest.approx(5.0 - 0.51)


def test_in_lockstep_a_node_that_is_not_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    devices = devices_of({"lidar": PLACE}, "test")
    monkeypatch.setattr(simulate, "_DISCOVERY", 0.3)
    robot = TopicRobot(Joined(None), devices, scene(devices), Link(lockstep=True))
    with pytest.raises(FlipperctlError, match="no node has answered on simulation/ready"):
        robot.prepare(0)


def test_messages_come_late_in_another_order_or_never() -> None:
    devices = devices_of({"lidar": PLACE}, "test")
    link = Link(rate=50.0, delay=0.02, jitter=0.05, loss=0.1)
    wire, stamps = Joined(None), []
    robot = TopicRobot(wire, devices, scene(devices), link)
    wire.sent = lambda topic, message: (  # type: ignore[method-assign]
        stamps.append((robot._now, message.header.stamp.nanosec * 1e-9 + message.header.stamp.sec))
        if topic == devices.topics.joints
        else None
    )
    robot._zero, robot._base, robot._now = None, 0.0, 0.0
    env = FlipperEnv(config=scene(devices))
    begun = time.monotonic()
    for number, _ in enumerate(decisions(env, robot, 5, observers=(robot,))):
        if number == 3:
            break
    assert time.monotonic() - begun > 1.5 / 50
    late = [now - stamp for now, stamp in stamps]
    assert min(late) >= 0.02 - 1e-6
    assert max(late) < 0.09  # a sample later at most
    order = [stamp for _, stamp in stamps]
    assert order != sorted(order)
    assert 0.8 < len(stamps) / (order[-1] / 0.01) < 0.97


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--lockstep", "--rate", "2"], "--lockstep has no rate and no step of the clock"),
        (["--clock-step", "3:x"], "--clock-step 3:x: a time and a step in s are allowed"),
        (["perception.pose=true"], "perception.pose=belts or matched is allowed"),
        (["devices=none.yaml"], "none.yaml cannot be read"),
    ],
)
def test_requests_without_effect_are_refused(words: list[str], text: str, tmp_path: Path) -> None:
    done = call("robot", "simulate", *words, cwd=tmp_path)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert text in done.err


def test_a_link_that_contradicts_itself_is_refused() -> None:
    with pytest.raises(RequestError):
        Link(lockstep=True, clock_step=(3.0, -5.0))
