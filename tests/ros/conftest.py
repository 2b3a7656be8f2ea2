"""Each distribution gets an environment of its own, with the wheels of PyPI.

Where these or the Python that they need are missing, its tests are skipped with the reason.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.call import call
from tests.environment import interpreter
from tests.ros.distributions import ALONE, DISTRIBUTIONS, MESSAGES, PACKAGE, ROOT, Ros


@pytest.fixture(scope="session")
def robot_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy, the devices and settings of the middleware, for both distributions."""
    folder = tmp_path_factory.mktemp("robot")
    lidar = {"x": 0.25, "z": 0.4, "axis": -0.7853981633974483}
    (folder / "d.json").write_text(json.dumps({"lidar": lidar}))
    (folder / "fast.xml").write_text(ALONE)
    words = "generalist", f"devices={folder / 'd.json'}", "--output", str(folder / "p.onnx")
    assert call("export", "onnx", *words, cwd=folder).code == 0
    return folder


@pytest.fixture(scope="session", params=DISTRIBUTIONS)
def distribution(
    request: pytest.FixtureRequest, robot_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Ros:
    version, prefix = DISTRIBUTIONS[request.param]
    if (base := interpreter(version)) is None:
        pytest.skip(f"this machine has no Python {version}, which {request.param} needs")
    place = tmp_path_factory.mktemp(request.param)
    subprocess.run([base, "-m", "venv", "--without-pip", place], check=True)
    python = place / "bin" / "python"
    wheels = [f"{prefix}{name}-msgs" for name in MESSAGES]
    wheels += [f"{prefix}{name}" for name in ("rclpy", "std-srvs", "rmw-fastrtps-cpp")]
    pip = [sys.executable, "-m", "pip", f"--python={python}", "install", "--no-compile", "--quiet"]
    wheels += ["numpy", "onnxruntime", "rosbags<0.12", "mcap", "pydantic"]
    done = subprocess.run([*pip, *wheels], capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"rclpy of {request.param} cannot be installed: {done.stderr.splitlines()[-1]}")
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "FLIPPERCTL"))}
    domain = 20 + 2 * os.getpid() % 60 + (request.param == "jazzy")
    variables = {"PYTHONPATH": f"{ROOT}:{PACKAGE}", "ROS_DOMAIN_ID": str(domain)}
    variables |= {"FASTDDS_DEFAULT_PROFILES_FILE": str(robot_folder / "fast.xml")}
    return Ros(python, robot_folder, clean | variables)


@pytest.fixture
def ros(distribution: Ros) -> Iterator[Ros]:
    """A distribution; no robot is left to the next test, which a test that fails would do."""
    yield distribution
    while distribution.robots:
        with distribution.robots.pop() as robot:
            robot.kill()
