"""An exported file is judged on a robot that agrees with what the file itself applies."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from flipperctl.api import Robot
from flipperctl.config import EnvConfig, Randomise
from flipperctl.config.randomise import SECTION_OF
from flipperctl.errors import ConfigError
from flipperctl.policies.source import PolicySource
from tests.cli.call import call
from tests.runtime import linear

STEP, LIMIT = math.pi / 12, math.pi / 3
OWN = {
    "robot": Robot().model_dump(exclude_none=True),
    "targets": {"meaning": "x", "window": STEP, "limit": LIMIT},
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return linear.write(tmp_path / "p.onnx", **OWN)


def build(file: Path, robot: dict[str, Any], **settings: Any) -> None:
    PolicySource(checkpoint=file).build(EnvConfig(terrain="flat", robot=robot, **settings))


@pytest.mark.parametrize(
    ("robot", "text", "export"),
    [
        (
            {"angle_limit": 0.3},
            r"a limit of 1\.0472 rad \(robot\.angle_limit asks for 0\.3\)",
            "robot.angle_limit=0.3",
        ),
        (
            {"angle_step": 0.2, "flipper_speed": 0.5},
            r"turns of 0\.261799 rad \(robot\.angle_step asks for 0\.2\), a decision period of "
            r"0\.6 s \(.* asks for 0\.4\)",
            "robot.angle_step=0.2 robot.flipper_speed=0.5",
        ),
        (  # the same period by another way is still another table
            {"angle_step": STEP / 2, "flipper_speed": Robot().flipper_speed / 2},
            r"turns of 0\.261799 rad \(robot\.angle_step asks for 0\.1309\), also on the real",
            f"robot.angle_step={STEP / 2!r} robot.flipper_speed={Robot().flipper_speed / 2!r}",
        ),
        (
            {"flipper_speed": 0.5},
            r"a decision period of 0\.6 s .* asks for 0\.523599\)",
            "robot.flipper_speed=0.5, or keep the file's period with randomise.flipper_speed=0.5",
        ),
        (
            {"control_period": 0.3},
            r"a decision period of 0\.6 s \(robot\.control_period asks for 0\.3\)",
            "robot.control_period=0.3",
        ),
    ],
)
def test_what_the_file_applies_itself_is_not_overridden(
    file: Path, robot: dict[str, float], text: str, export: str
) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        build(file, robot)
    line = str(caught.value)
    assert line.startswith(f"{file} applies ")
    assert line.endswith(f"flipperctl export onnx --checkpoint RUN {export}")
    assert "\n" not in line


APPLIED = {"angle_step", "angle_limit", "control_period"}


@pytest.mark.parametrize("field", sorted(set(Robot.model_fields) - APPLIED))
def test_what_the_robot_is_like_may_be_overridden(file: Path, field: str) -> None:
    if field == "flipper_speed":  # it is varied without the decision period, by randomise alone
        build(file, {}, randomise={"flipper_speed": [0.3, 0.6]})
        return
    default = getattr(Robot(), field)
    build(file, {field: 0.05 + 1.01 * (1.0 if default is None else default)})


def test_randomise_has_nothing_that_a_file_applies() -> None:
    assert not APPLIED & (SECTION_OF.keys() | Randomise.model_fields.keys())
    assert Robot.not_sampled >= APPLIED


def test_a_file_that_contradicts_its_own_robot_is_refused(tmp_path: Path) -> None:
    degrees = [[i * 15.0, j * 15.0] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    path = linear.write(tmp_path / "p.onnx", **OWN, actions=degrees)
    with pytest.raises(ConfigError, match=r"turns of 15 rad .*unlike the robot in its own"):
        build(path, {})


def test_eval_drives_the_file_s_own_robot_and_refuses_another(tmp_path: Path) -> None:
    robot = {**Robot().model_dump(exclude_none=True), "angle_limit": 0.3}
    targets = {"meaning": "x", "window": STEP, "limit": 0.3}
    flat = {"terrain": "flat", "terrain_config": {"name": "flat"}}
    linear.write(tmp_path / "p.onnx", robot=robot, targets=targets, **flat)
    evaluate = ("eval", "--checkpoint", "p.onnx", "--episodes", "1", "--json")
    done = call(*evaluate, cwd=tmp_path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["scenes"][0]["conditions"]["robot"]["angle_limit"] == 0.3
    for command in (
        evaluate,
        ("inspect", "reward", "--compare", "okada,p.onnx"),
        ("eval", "p.onnx", "sim=planar,mujoco"),
        ("map", "p.onnx", "--over", "sim.friction,sim.gravity"),
    ):
        done = call(*command, "robot.angle_limit=0.9", cwd=tmp_path)
        assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
        assert "error: p.onnx applies a limit of 0.3 rad" in done.err


def test_policies_compared_by_reward_drive_the_robot_of_their_files(tmp_path: Path) -> None:
    robot = {**Robot().model_dump(exclude_none=True), "angle_limit": 0.3}
    targets = {"meaning": "x", "window": STEP, "limit": 0.3}
    linear.write(tmp_path / "p.onnx", robot=robot, targets=targets)
    compare = ("inspect", "reward", "--episodes", "1", "--json", "terrain=flat", "--compare")
    done = call(*compare, "level,p.onnx", cwd=tmp_path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["scenes"][0]["conditions"]["robot"]["angle_limit"] == 0.3
    done = call(*compare, "p.onnx,generalist", cwd=tmp_path)
    assert done.code == 2
    assert done.err == (
        "error: --compare: p.onnx is for robot.angle_limit=0.3, generalist for 1.0472; "
        "give robot.angle_limit=… to choose the robot\n"
    )
    done = call(*compare, "p.onnx,generalist", "robot.angle_limit=0.3", cwd=tmp_path)
    assert done.code == 0, done.err
