"""The packaged node on real rclpy of two distributions, beside a simulated robot in its process.

Each distribution gets an environment of its own, with the wheels of PyPI; where these or the Python
that they need are missing, its tests are skipped with the reason.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from flipperctl.commands.robot import recorded_robot
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.runtime.devices import Devices
from tests.cli.call import call
from tests.environment import interpreter

pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "ros2" / "flipperctl_ros"
MESSAGES = ("sensor", "std", "diagnostic", "nav", "geometry", "visualization")
DISTRIBUTIONS = {"jazzy": ("3.12", "ros-jazzy-"), "kilted": ("3.10", "ros-")}
ALONE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com"><profiles>
<participant profile_name="p" is_default_profile="true"><rtps><propertiesPolicy><properties>
<property><name>fastdds.type_propagation</name><value>disabled</value></property>
</properties></propertiesPolicy></rtps></participant></profiles></dds>
"""


@dataclass(frozen=True)
class Node:
    """The packaged node in its process."""

    process: subprocess.Popen[bytes]
    log: Path

    def wait_for(self, text: str) -> None:
        until = time.monotonic() + 60
        while text not in self.log.read_text():
            assert time.monotonic() < until, self.log.read_text()
            time.sleep(0.2)


@dataclass(frozen=True)
class Ros:
    """A distribution of ROS 2 in an environment of its own, and a policy with its devices."""

    python: Path
    folder: Path
    variables: dict[str, str]

    @contextmanager
    def node(self, **parameters: Any) -> Iterator["Node"]:
        """Run the node until the end of the block."""
        words = [f"{name}:={value}" for name, value in parameters.items()]
        given = [word for pair in zip(["-p"] * len(words), words, strict=True) for word in pair]
        command = [self.python, "-m", "flipperctl_ros.node", "--ros-args", *given]
        command += ["-p", f"policy:={self.folder / 'p.onnx'}"]
        log = self.folder / f"node{time.monotonic_ns()}.log"
        with log.open("w") as file:
            process = subprocess.Popen(
                command, env=self.variables, stdout=file, stderr=subprocess.STDOUT
            )
        try:
            yield Node(process, log)
        finally:
            process.kill()
            process.wait()

    def simulate(self, *words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "flipperctl", "robot", "simulate", *words, "--json"]
        return subprocess.Popen(
            [*command, f"devices={self.folder / 'd.json'}", "sim=mujoco"],
            env=self.variables | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def episodes(self, process: subprocess.Popen[str]) -> list[dict[str, Any]]:
        out, err = process.communicate(timeout=1500)
        assert process.returncode == 0, err
        rows: list[dict[str, Any]] = json.loads(out)["episodes"]
        return rows


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    version, prefix = DISTRIBUTIONS[request.param]
    if (base := interpreter(version)) is None:
        pytest.skip(f"this machine has no Python {version}, which {request.param} needs")
    folder = tmp_path_factory.mktemp(request.param)
    subprocess.run([base, "-m", "venv", folder / "v"], check=True)
    python = folder / "v" / "bin" / "python"
    wheels = [f"{prefix}{name}-msgs" for name in MESSAGES]
    wheels += [f"{prefix}{name}" for name in ("rclpy", "std-srvs", "rmw-fastrtps-cpp")]
    pip = [python, "-m", "pip", "install", "--quiet", *wheels, "numpy", "onnxruntime"]
    done = subprocess.run(pip, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"rclpy of {request.param} cannot be installed: {done.stderr.splitlines()[-1]}")
    lidar = {"x": 0.25, "z": 0.4, "axis": -0.7853981633974483}
    (folder / "d.json").write_text(json.dumps({"lidar": lidar}))
    (folder / "fast.xml").write_text(ALONE)
    words = "generalist", f"devices={folder / 'd.json'}", "--output", str(folder / "p.onnx")
    assert call("export", "onnx", *words, cwd=folder).code == 0
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "FLIPPERCTL"))}
    domain = 20 + 2 * os.getpid() % 60 + (request.param == "jazzy")
    variables = {"PYTHONPATH": f"{ROOT}:{PACKAGE}", "ROS_DOMAIN_ID": str(domain)}
    variables |= {"FASTDDS_DEFAULT_PROFILES_FILE": str(folder / "fast.xml")}
    return Ros(python, folder, clean | variables)


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
        row, *_ = ros.episodes(ros.simulate("terrain=paper_step", "--lockstep"))
        node.process.send_signal(signal.SIGTERM)
        assert node.process.wait(30) == 0
        assert "Traceback" not in node.log.read_text()
    assert row["outcome"] == "reached"
    assert row["targets"] == in_process(ros.folder, row, "terrain=paper_step")
    assert set(row["diagnoses"]) == {"driving"}


@pytest.mark.long
@pytest.mark.parametrize("terrain", ["paper_step", "paper_stair"])
def test_twenty_episodes_in_lockstep_are_those_in_process(ros: Ros, terrain: str) -> None:
    with ros.node(lockstep=True, escape=True):
        words = f"terrain={terrain}", "--lockstep", "--episodes", "20"
        rows = ros.episodes(ros.simulate(*words))
    assert [row["outcome"] for row in rows] == ["reached"] * 20
    for row in rows:
        assert row["targets"] == in_process(ros.folder, row, f"terrain={terrain}")


def test_over_a_bad_link_it_crosses_the_step(ros: Ros) -> None:
    """Messages that are lost, late and in another order cost a hold, and no stop that lasts."""
    link = "--loss", "0.01", "--delay", "0.02", "--jitter", "0.05"
    with ros.node() as node:
        (row,) = ros.episodes(ros.simulate("terrain=paper_step", *link))
        assert node.process.poll() is None
    assert row["outcome"] == "reached"
    assert row["diagnoses"]["driving"] > 0.8 * sum(row["diagnoses"].values())


def test_a_second_node_refuses_and_a_killed_one_stops_the_robot(ros: Ros) -> None:
    with ros.node() as first:
        robot = ros.simulate("terrain=flat", "terrain.length=2")
        first.wait_for("driving")
        with ros.node() as second:
            second.wait_for("another node commands joint_command")  # refused, or stopped
        assert "another node" not in first.log.read_text()
        first.process.send_signal(signal.SIGKILL)
        (row,) = ros.episodes(robot)
    # Without a command the motors stand: the robot makes no way, until the episode is over.
    assert row["outcome"] == "timeout"
    assert row["commands"] > 30
