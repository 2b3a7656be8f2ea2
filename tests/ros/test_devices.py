"""One file of a robot's devices, at every door that takes it."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from flipperctl.api import Robot
from flipperctl.config.resolver import named_robot
from flipperctl.runtime import FlipperController, OnnxPolicy
from flipperctl.runtime.__main__ import _main
from flipperctl.runtime.devices import Devices, read_devices, robot_devices
from tests.cli.call import call
from tests.environment import interpreter
from tests.runtime.linear import ROBOT, RULE, write
from tests.runtime.robot import SETUP
from tests.runtime.robot import Robot as Simulated

ROOT = Path(__file__).parents[2]
ROVER = """
chassis_length: 0.6
devices:
  joints: {front: [fl, fr], rear: [rl, rr]}
  lidar: {x: 0.2, z: 0.35, axis: -0.7}
  overall_width: 0.6
"""


@pytest.fixture
def rover(tmp_path: Path) -> Path:
    (tmp_path / "rover.yaml").write_text(ROVER)
    return tmp_path


def test_the_draft_of_a_robot_is_nubot_with_its_devices(tmp_path: Path) -> None:
    done = call("new", "robot", "mine", cwd=tmp_path)
    assert done.code == 0
    assert "flipperctl eval okada robot=mine.yaml\n" in done.out
    assert read_devices(tmp_path / "mine.yaml") == robot_devices(tmp_path / "mine.yaml")
    assert read_devices(tmp_path / "mine.yaml") == Devices()
    assert named_robot(str(tmp_path / "mine.yaml")) == Robot()
    assert call("new", "robot", "mine", cwd=tmp_path).code == 2  # nothing is overwritten


def test_an_evaluation_and_a_training_take_the_devices(rover: Path) -> None:
    words = "robot=rover.yaml", "devices=rover.yaml", "terrain=step"
    shown = call("inspect", "config", *words, cwd=rover).out
    assert "mount_x: 0.2" in shown
    assert "overall_width: 0.6" in shown
    assert "pose: belts" in shown
    # A robot's file holds them, unless another sensor is chosen.
    body, *rest = words[0], *words[2:]
    assert call("inspect", "config", body, *rest, cwd=rover).out == shown
    chosen = call("inspect", "config", body, *rest, "perception=planar", cwd=rover)
    assert (chosen.code, "mount_axis" in chosen.out) == (0, False)
    changed = call("inspect", "config", *words, "perception.overall_width=0.7", cwd=rover).out
    assert "overall_width: 0.7" in changed  # what is typed counts
    trained = call("train", body, "device=none", cwd=rover)  # it says so before anything else
    assert trained.err.startswith("perception=lidar, as devices of a robot are named\n")
    refused = call("eval", "okada", "devices=none.yaml", cwd=rover)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "none.yaml cannot be read" in refused.err
    planar = call("eval", "okada", "devices=rover.yaml", "perception=planar", cwd=rover)
    assert planar.code == 2
    assert "devices=FILE has the place and the widths of a LiDAR" in planar.err
    (rover / "body.yaml").write_text("chassis_length: 0.6\n")
    body = call("eval", "okada", "devices=body.yaml", cwd=rover)
    assert (body.code, "there is no section 'devices'" in body.err) == (2, True)


def test_a_recording_is_read_by_the_names_of_the_devices(rover: Path) -> None:
    words = "terrain=step", "perception=lidar", "perception.pose=belts", "perception.azimuths=60"
    short = "episode.run_up=0.8", "episode.run_out=0.4"
    assert call("export", "mcap", "okada", *words, *short, "--output", "bag", cwd=rover).code == 0
    theirs = {"joints": {"front": ["front_left_flipper", "-front_right_flipper"]}}
    (rover / "wrong.json").write_text(json.dumps(theirs))
    plain = call("robot", "check", "bag", "--json", cwd=rover)
    wrong = call("robot", "check", "bag", "devices=wrong.json", "--json", cwd=rover)
    assert plain.code == wrong.code == 0
    rows = [
        [row for row in json.loads(done.out)["checks"] if row["quantity"] == "angle"]
        for done in (plain, wrong)
    ]
    assert [row["verdict"] for rows_of in rows for row in rows_of] == ["ok", "refused"]
    lost = call("robot", "check", "bag", "robot=rover.yaml", "--json", cwd=rover)
    assert "no JointState has the joints fl, fr, rl, rr" in lost.out


def test_a_bag_of_an_episode_has_the_names_and_units_of_the_devices(tmp_path: Path) -> None:
    settings = {
        "topics": {"clouds": "os/points", "belts": "belts", "joints": "arms"},
        "joints": {"front": ["lf", "-rf"], "rear": ["lr", "-rr"], "scale": math.radians(1)},
        "belts": {"scale": 0.001},
        "frames": {"base": "chassis"},
    }
    (tmp_path / "d.json").write_text(json.dumps(settings))
    words = "terrain=step", "perception=lidar", "perception.pose=belts", "perception.azimuths=60"
    words = *words, "episode.run_up=0.8", "episode.run_out=0.4"
    checks = []
    for name, more in (("ours", ()), ("theirs", ("devices=d.json",))):
        done = call("export", "mcap", "okada", *words, *more, "--output", name, cwd=tmp_path)
        assert done.code == 0, done.err
        checks.append(json.loads(call("robot", "check", name, *more, "--json", cwd=tmp_path).out))
    ours, theirs = checks
    topics = {"cloud": "/os/points", "attitude": "/imu/data", "joints": "/arms"}
    assert theirs["topics"] == topics | {"odometry": "/belts"}
    assert theirs["scans"] == ours["scans"]
    verdicts = [[row["verdict"] for row in each["checks"]] for each in checks]
    assert verdicts[0] == verdicts[1]


def test_an_exported_policy_carries_the_devices(rover: Path) -> None:
    done = call(
        "export", "onnx", "generalist", "devices=rover.yaml", "--output", "p.onnx", cwd=rover
    )
    assert done.code == 0, done.err
    assert OnnxPolicy(rover / "p.onnx").interface.devices == read_devices(rover / "rover.yaml")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A policy, and the messages of a robot that it drove over a step, as lines of JSON."""
    folder = tmp_path_factory.mktemp("drive")
    file = write(folder / "p.onnx", robot=ROBOT, targets=RULE)
    robot, lines = Simulated(FlipperController(file, SETUP), ground="step"), []

    def note(device: str, message: dict) -> None:
        plain = {k: v.tolist() if hasattr(v, "tolist") else v for k, v in message.items()}
        plain |= {"frame": "lidar"} if device == "cloud" else {}
        lines.append({"time": message["time"], device: plain})

    robot.run(6.0, note)
    (folder / "m.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    place = {"x": 0.0, "z": 0.0, "axis": math.pi / 2, "near": 0.01}
    devices = {"lidar": place, "joints": {"signs": "flipperctl"}}
    (folder / "d.json").write_text(json.dumps(devices))
    return folder, file


def test_the_devices_of_a_policy_count_in_shadow_mode(tmp_path: Path) -> None:
    """Of a policy that holds none, the joints of this bag have other names."""
    settings = {"joints": {"front": ["fl", "-fr"], "rear": ["rl", "-rr"], "scale": 0.1}}
    (tmp_path / "d.json").write_text(json.dumps(settings))
    devices = "devices=d.json"
    words = "terrain=step", "perception=lidar", "perception.pose=belts", "perception.azimuths=60"
    words = *words, "episode.run_up=0.8", "episode.run_out=0.4", devices, "--output", "bag"
    assert call("export", "mcap", "okada", *words, cwd=tmp_path).code == 0
    policy = "export", "onnx", "generalist", devices, "--output", "p.onnx"
    assert call(*policy, cwd=tmp_path).code == 0
    logs = []
    for more in ((), (devices,)):
        shadow = call("robot", "shadow", "p.onnx", "bag", *more, "--json", cwd=tmp_path)
        document = json.loads(shadow.out)
        assert document["topics"]["joints"] == "/joint_states"
        assert document["decisions"] > 3
        logs.append(document)
    assert logs[0] == logs[1]


def test_the_runtime_reads_devices_without_flipperctls_packages(
    drive: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, file = drive
    words = ["--shadow", str(file), str(folder / "m.jsonl"), f"devices={folder / 'd.json'}"]
    assert _main(words) == 0
    log = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert sum(line["action"] is not None for line in log) > 5


@pytest.mark.slow
def test_core_and_runtime_decide_the_same_on_python_3_10(
    drive: tuple[Path, Path], tmp_path: Path
) -> None:
    """As on Humble and JetPack 6, with numpy and onnxruntime alone."""
    if (oldest := interpreter("3.10")) is None:
        pytest.skip("this machine has no Python 3.10")
    subprocess.run([oldest, "-m", "venv", tmp_path / "v"], check=True)
    python = tmp_path / "v" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "numpy", "onnxruntime"]
    subprocess.run(pip, check=True, capture_output=True)
    folder, file = drive
    words = ["--shadow", file, folder / "m.jsonl", f"devices={folder / 'd.json'}"]
    command = ["-m", "flipperctl.runtime", *words]
    logs = []
    for program in (python, sys.executable):
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "FLIPPERCTL"))}
        clean |= {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run([program, *command], env=clean, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        logs.append([json.loads(line) for line in done.stdout.splitlines()])
    oldest_log, ours = logs
    assert oldest_log == ours
    assert sum(line["action"] is not None for line in ours) > 5
