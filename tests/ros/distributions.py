"""The packaged node on real rclpy in an environment of its own, and a simulated robot beside it."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
WAIT = 240  # for what comes within seconds, as the machine may be busy [s]
PACKAGE = ROOT / "examples" / "ros2" / "flipperctl_ros"
MESSAGES = ("sensor", "std", "diagnostic", "nav", "geometry", "visualization")
DISTRIBUTIONS = {"jazzy": ("3.12", "ros-jazzy-"), "kilted": ("3.10", "ros-")}
ALONE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com"><profiles>
<participant profile_name="p" is_default_profile="true"><rtps><propertiesPolicy><properties>
<property><name>fastdds.type_propagation</name><value>disabled</value></property>
</properties></propertiesPolicy></rtps></participant></profiles></dds>
"""
CLIENT = """
import json, sys, rclpy, std_srvs.srv as services
name, kind, request = sys.argv[1:]
kind = getattr(services, kind)
rclpy.init()
node = rclpy.create_node("client")
client = node.create_client(kind, name)
assert client.wait_for_service(120)
answer = client.call_async(kind.Request(**json.loads(request)))
rclpy.spin_until_future_complete(node, answer, timeout_sec=120)
print(answer.result().message)
"""


@dataclass(frozen=True)
class Node:
    """The packaged node in its process."""

    process: subprocess.Popen[bytes]
    log: Path

    def wait_for(self, text: str) -> None:
        until = time.monotonic() + WAIT
        while text not in self.log.read_text():
            assert time.monotonic() < until, self.log.read_text()
            time.sleep(0.2)


@dataclass(frozen=True)
class Ros:
    """A distribution of ROS 2 in an environment of its own, and a policy with its devices."""

    python: Path
    folder: Path
    variables: dict[str, str]
    within: tuple[str, ...] = ()
    """Beginning of each command, as of one that enters a network of its own."""
    robots: list[subprocess.Popen[str]] = field(default_factory=list)
    """Those of the present test."""

    @contextmanager
    def node(self, until: str = "active: commands", **parameters: Any) -> Iterator["Node"]:
        """Run the node from a line of its log on to the end of the block; the policy may command.

        So a simulated robot, which waits for a node for 10 s, waits for none that still starts.
        """
        given = {"policy": self.folder / "p.onnx", "enabled": True} | parameters
        words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        with self.node_of(["--ros-args", *words], until) as node:
            yield node

    @contextmanager
    def node_of(
        self, words: list[str], until: str = "active: commands", cwd: Path | None = None
    ) -> Iterator["Node"]:
        """Run the node by the words of a command line."""
        command = [*self.within, self.python, "-m", "flipperctl_ros.node", *words]
        log = self.folder / f"node{time.monotonic_ns()}.log"
        with log.open("w") as file:
            process = subprocess.Popen(
                command, env=self.variables, cwd=cwd, stdout=file, stderr=subprocess.STDOUT
            )
        try:
            node = Node(process, log)
            node.wait_for(until)
            yield node
        finally:
            process.kill()
            process.wait()

    def simulate(self, *words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "flipperctl", "robot", "simulate", *words, "--json"]
        robot = subprocess.Popen(
            [*self.within, *command, f"devices={self.folder / 'd.json'}", "sim=mujoco"],
            env=self.variables | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.robots.append(robot)
        return robot

    def call(self, service: str, kind: str = "Trigger", **request: Any) -> str:
        """Call a service of the node; return its message."""
        command = [self.python, "-c", CLIENT, service, kind, json.dumps(request)]
        done = subprocess.run(command, env=self.variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    @contextmanager
    def listener(self, monkeypatch: pytest.MonkeyPatch) -> Iterator["Listener"]:
        """Listen to the topics until the end of the block."""
        from flipperctl.ros.dds import CycloneWire

        monkeypatch.setenv("ROS_DOMAIN_ID", self.variables["ROS_DOMAIN_ID"])
        wire = CycloneWire("listener")
        try:
            yield Listener(wire)
        finally:
            wire.close()

    def episodes(self, process: subprocess.Popen[str]) -> list[dict[str, Any]]:
        out, err = process.communicate(timeout=7200)
        assert process.returncode == 0, err
        rows: list[dict[str, Any]] = json.loads(out)["episodes"]
        return rows


class Listener:
    """What the robot did and what the node said."""

    def __init__(self, wire: Any) -> None:
        self.ways, self.faults = [0.0], set[str]()
        self.commands: list[float] = []  # speeds of the belts [m/s]
        wire.subscribe("odom", "nav_msgs/msg/Odometry", self._on_odometry)
        wire.subscribe("joint_command", "sensor_msgs/msg/JointState", self._on_command)
        wire.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._on_diagnosis)

    def _on_odometry(self, message: Any) -> None:
        self.ways.append(message.pose.pose.position.x)

    def _on_command(self, message: Any) -> None:
        self.commands.append(float(message.velocity[-1]))

    def _on_diagnosis(self, message: Any) -> None:
        self.faults |= {v.value for v in message.status[0].values if v.key == "fault"}

    def wait_for_fault(self, name: str) -> None:
        until = time.monotonic() + WAIT
        while name not in self.faults:
            assert time.monotonic() < until, self.faults
            time.sleep(0.05)

    def stands(self) -> bool:
        """Return whether the robot, 2 s later, moves no more for 2 s: by its samples of 0.01 s."""
        begun, until = len(self.ways), time.monotonic() + WAIT
        while len(self.ways) < begun + 400:
            assert time.monotonic() < until, "the robot tells its place no more"
            time.sleep(0.05)
        return abs(self.ways[begun + 399] - self.ways[begun + 200]) < 0.01
