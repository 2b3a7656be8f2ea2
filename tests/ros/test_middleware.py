"""The packaged node on real rclpy of two distributions, beside a simulated robot in its process."""

import itertools
import json
import signal
import subprocess
import threading
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from flipperctl.commands.robot import recorded_robot
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros.messages import Messages
from flipperctl.runtime.devices import Devices, read_devices
from flipperctl.runtime.messages import KINDS
from flipperctl.runtime.recordings import SelfTest, read_lines, setup_by
from tests.cli.call import call
from tests.ros.distributions import WAIT, Ros
from tests.ros.network import network
from tests.ros.recorder import recording

pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
from flipperctl.ros.dds import CycloneWire

pytestmark = pytest.mark.ros

FLAT = "terrain=flat", "terrain.length=1", "episode.run_up=0.3", "episode.run_out=0.2"
FEW = "perception.azimuths=60"  # rays, which are most of the simulation's time
FLAT = *FLAT, "episode.slack=30", "episode.stuck_window=1000", FEW
SHORT = "terrain=step", "terrain.height=0.4", "episode.run_up=0.8", "episode.run_out=0.6", FEW
BEGIN = "joints_missing", "cloud_missing", "coverage", "standby"
CLOCK = {"use_sim_time": True}  # so that a busy machine is no fault of its own
WIRE = """
import time
from flipperctl.ros.messages import Messages
from flipperctl.ros.wire import open_wire
wire, heard = open_wire("ours"), []
wire.subscribe("ping", "std_msgs/msg/Float64", lambda message: heard.append(message.data))
publish = wire.publisher("pong", "std_msgs/msg/Float64")
while 4.0 not in heard:
    publish(Messages().number(2.0))
    time.sleep(0.1)
print(type(wire).__name__, wire.publisher("/tf", "tf2_msgs/msg/TFMessage"))
wire.close()
"""


def in_process(folder: Path, row: dict[str, Any], *words: str) -> list[list[float]]:
    """The targets of the same episode of the exported policy, without topics."""
    words = (*words, "sim=mujoco", f"devices={folder / 'd.json'}")
    config = recorded_robot(words, Devices()).config
    policy, env = load_policy(folder / "p.onnx").build(config), FlipperEnv(config=config)
    seed = EvaluationSeeds.of(config.eval.seed, config.terrain)(row["episode"])
    played = decisions(env, policy, seed)
    return [[round(float(angle), 6) for angle in env.drive.targets] for _ in played]


def test_in_lockstep_each_target_is_that_of_the_episode_in_process(ros: Ros) -> None:
    with ros.node(lockstep=True, escape=True) as node:
        row, *_ = ros.episodes(ros.simulate("terrain=paper_step", "--lockstep", FEW))
        node.process.send_signal(signal.SIGTERM)
        assert node.process.wait(WAIT) == 0
        assert "Traceback" not in node.log.read_text()
    assert row["outcome"] == "reached"
    assert row["targets"] == in_process(ros.folder, row, "terrain=paper_step", FEW)
    assert set(row["diagnoses"]) == {"driving"}
    assert row["processor_share"] > 0


@pytest.mark.long
@pytest.mark.parametrize("terrain", ["paper_step", "paper_stair"])
def test_twenty_episodes_in_lockstep_are_those_in_process(ros: Ros, terrain: str) -> None:
    with ros.node(lockstep=True, escape=True):
        words = f"terrain={terrain}", "--lockstep", "--episodes", "20"
        rows = ros.episodes(ros.simulate(*words))
    assert [row["outcome"] for row in rows] == ["reached"] * 20
    for row in rows:
        assert row["targets"] == in_process(ros.folder, row, f"terrain={terrain}")


@pytest.mark.long
def test_half_an_hour_of_courses_raises_nothing_and_needs_no_more_memory(ros: Ros) -> None:
    sizes: list[int] = []  # of the node [kB]
    words = "terrain=course", "--episodes", "10", "--sim-time", FEW
    rows: list[dict[str, Any]] = []
    with ros.node(use_sim_time=True, escape=True) as node:
        ended = threading.Event()

        def watch() -> None:
            while not ended.wait(5):
                status = Path(f"/proc/{node.process.pid}/status").read_text()
                sizes.append(int(status.partition("VmRSS:")[2].split()[0]))

        watcher = threading.Thread(target=watch)
        watcher.start()
        for seed in itertools.count():  # by a clock that begins anew
            if sum(row["seconds"] for row in rows) > 1800:
                break
            rows += ros.episodes(ros.simulate(*words, f"eval.seed={seed}"))
        ended.set()
        watcher.join()
        assert node.process.poll() is None
        assert "Traceback" not in node.log.read_text()
    faults = {name for row in rows for name in row["diagnoses"]}
    assert not faults & {"inference", "clock_jump", "motion_sign", "motion_scale", "motion_sides"}
    third = len(sizes) // 3
    assert max(sizes[-third:]) < max(sizes[third : 2 * third]) + 4000


def test_a_bag_of_the_topics_opens_by_the_names_of_ros_2(
    ros: Ros, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", ros.variables["ROS_DOMAIN_ID"])
    devices = read_devices(ros.folder / "d.json")
    wire = CycloneWire("recorder")
    with recording(tmp_path / "bag", devices) as recorder, ros.node(lockstep=True):
        for topic, kind in recorder.kinds.items():
            take = partial(recorder.take, topic)
            wire.subscribe(topic, kind, take, latched=topic == "/tf_static")
        # In lockstep clouds are reliable, too; a short course has all that a long one has.
        short = *FLAT, "--lockstep"
        (row,) = ros.episodes(ros.simulate(*short))
        wire.close()
        counts = dict(recorder.counts)
    assert row["outcome"] == "reached"
    assert set(counts) == set(recorder.kinds)

    # By rosbags and by mcap: the names of topics and types are those of ROS 2.
    with Reader(tmp_path / "bag") as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == recorder.kinds
        read = Counter(connection.topic for connection, *_ in reader.messages())
    assert read == counts
    (file,) = (tmp_path / "bag").glob("*.mcap")
    with file.open("rb") as stream:
        mcap = make_reader(stream)
        summary = mcap.get_summary()
        channels = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
        assert {topic: schema.name for topic, schema in channels.items()} == recorder.kinds
        assert {schema.encoding for schema in channels.values()} == {"ros2msg"}
        assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        assert Counter(channel.topic for _, channel, _ in mcap.iter_messages()) == counts
    words = "bag", f"devices={ros.folder / 'd.json'}", "--json"
    checked = call("robot", "check", *words, cwd=tmp_path)
    assert checked.code == 0, checked.err
    perceived = json.loads(checked.out)
    assert (perceived["scans"], perceived["refused"]) == (counts["/points"], {})


def test_the_topics_of_a_simulated_robot_go_over_rclpy_where_it_is(
    ros: Ros, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Types that are not installed, as those of tf in these environments, are left out."""
    if "kilted" in request.node.name:
        pytest.skip("a simulated robot needs Python 3.11")
    monkeypatch.setenv("ROS_DOMAIN_ID", ros.variables["ROS_DOMAIN_ID"])
    heard: list[float] = []
    wire, kind, until = CycloneWire("theirs"), "std_msgs/msg/Float64", time.monotonic() + WAIT
    wire.subscribe("pong", kind, lambda message: heard.append(message.data))
    publish, command = wire.publisher("ping", kind), [ros.python, "-c", WIRE]
    with subprocess.Popen(command, env=ros.variables, stdout=subprocess.PIPE, text=True) as ours:
        while ours.poll() is None and time.monotonic() < until:
            publish(Messages().number(4.0 if heard else 3.0))
            time.sleep(0.1)
        ours.kill()
        assert ours.stdout is not None
        assert ours.stdout.read() == "_Rclpy None\n"
    wire.close()
    assert set(heard) == {2.0}


def test_topics_are_printed_as_the_lines_of_the_self_test(ros: Ros) -> None:
    file = ros.folder / "d.json"
    words = "--ros-args", "-p", f"devices:={file}", "-p", "use_sim_time:=true"
    command = [ros.python, "-m", "flipperctl_ros.messages", *words]
    robot = ros.simulate(*FLAT, "--sim-time")
    with subprocess.Popen(command, env=ros.variables, stdout=subprocess.PIPE, text=True) as printer:
        assert printer.stdout is not None
        silent = threading.Timer(WAIT, printer.kill)  # lines would be waited for without an end
        silent.start()
        lines = list(islice(printer.stdout, 400))
        printer.send_signal(signal.SIGINT)
        printer.stdout.read()
        assert printer.wait() == 0
        silent.cancel()
    robot.kill()
    devices = read_devices(file)
    parts = [messages for _, messages in read_lines(lines, "topics", devices)]
    assert {device for part in parts for device in part} == set(KINDS)
    angles = [part["joints"] for part in parts if "joints" in part]
    assert max(abs(joints.front) for joints in angles) < 0.1  # they stand level
    test = SelfTest(setup_by(devices, "rep103"), of_devices=True)
    for now, messages in read_lines(lines, "topics", devices):
        test.step(now, **messages)
    assert not test.refused


def test_over_a_bad_link_it_crosses_the_step(ros: Ros) -> None:
    """Messages that are lost, late and in another order cost no hold, and no stop.

    They are so in simulated time, and each sample waits for the node: the machine adds nothing.
    """
    link = "--loss", "0.01", "--delay", "0.02", "--jitter", "0.05"
    with ros.node(lockstep=True) as node:
        (row,) = ros.episodes(ros.simulate(*SHORT, *link, "--lockstep"))
        assert node.process.poll() is None
        assert '"latched": true' not in node.log.read_text()
    assert row["outcome"] == "reached"
    # It begins without messages and with little ground, and drives from then on without a hold.
    assert set(row["diagnoses"]) == {*BEGIN, "driving"}
    assert row["diagnoses"]["driving"] > 0.85 * sum(row["diagnoses"].values())


def test_a_second_node_refuses_and_a_killed_one_stops_the_robot(
    ros: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node that was killed and started again does not move it until it is enabled."""
    with ros.listener(monkeypatch) as heard, ros.node(**CLOCK) as first:
        robot = ros.simulate(*FLAT, "--sim-time")
        first.wait_for("driving")
        first.process.send_signal(signal.SIGKILL)
        assert heard.stands()
        heard.commands.clear()
        with ros.node(enabled=False, **CLOCK) as second:
            assert heard.stands()
            assert set(heard.commands) == {0.0}
            time.sleep(
                7
            )  # of two that are younger than 10 s both stop, if they see each other late
            with ros.node("another node commands joint_command", **CLOCK):
                pass  # refused, or stopped
            assert "another node" not in second.log.read_text()
            assert ros.call("enable", "SetBool", data=True) == "enabled"
            (row,) = ros.episodes(robot)
    assert row["outcome"] == "reached"


@pytest.mark.parametrize(
    ("seconds", "service", "answer"),
    [(5.0, "acknowledge", "acknowledged"), (-5.0, "reset", "the map is empty")],
)
def test_a_clock_that_steps_stops_the_robot_until_it_is_acknowledged(
    ros: Ros, monkeypatch: pytest.MonkeyPatch, seconds: float, service: str, answer: str
) -> None:
    with ros.listener(monkeypatch) as heard, ros.node(**CLOCK) as node:
        robot = ros.simulate(*FLAT, "--sim-time", "--clock-step", f"2:{seconds}")
        heard.wait_for_fault("clock_jump")
        assert heard.stands()
        assert heard.commands[-1] == 0.0
        assert ros.call(service) == answer
        (row,) = ros.episodes(robot)
        assert "Traceback" not in node.log.read_text()
    assert row["outcome"] == "reached"


def test_a_link_that_is_cut_for_6_s_stops_the_robot_until_it_is_back(
    ros: Ros, request: pytest.FixtureRequest
) -> None:
    """Messages that were on their way come late, too."""
    if "kilted" in request.node.name:
        reason = (
            "in 1 of 5 runs Kilted's Fast DDS heard Cyclone DDS for 8 s after the cut, then no more"
        )
        request.applymarker(pytest.mark.xfail(reason=reason))
    with network() as (here, there, switch):
        # By the clock of the machine, which no link cuts; it may be busy, so messages may be late.
        ages = dict.fromkeys(("cloud", "attitude", "joints", "odometry"), 3.0)
        limits = {"ages": ages, "clock_jump": 5.0}
        settings = json.loads((ros.folder / "d.json").read_text()) | {"limits": limits}
        (ros.folder / "late.json").write_text(json.dumps(settings))
        with replace(ros, within=here).node(devices=ros.folder / "late.json") as node:
            robot = replace(ros, within=there).simulate(*FLAT)
            node.wait_for("driving")
            switch("down")
            time.sleep(6)
            node.wait_for('"state": "stopped"')
            switch("up")
            (row,) = ros.episodes(robot)
            assert "Traceback" not in node.log.read_text()
    assert row["outcome"] == "reached"
    assert row["seconds"] > 6 + 1.4 / 0.2
