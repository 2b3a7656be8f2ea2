"""An exported policy in the simulator: acts as its checkpoint, on a robot that agrees with it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.config import EnvConfig, Randomise
from flipperctl.errors import CheckpointError, ConfigError, PluginError, PolicyError
from flipperctl.policies.source import PolicySource, exported_config
from tests.cli.call import call, refused
from tests.runtime import linear


def test_the_file_holds_its_terrain_robot_and_layout(tmp_path: Path) -> None:
    robot = {"chassis_length": 0.9, "flipper_length": 0.5}
    flat = {"terrain": "flat", "terrain_config": {"name": "flat"}}
    path = linear.write(tmp_path / "p.onnx", robot=robot, bin_width=0.1, **flat)
    config = exported_config(path)
    assert config.terrain.plugin_name == "flat"
    assert config.robot.chassis_length == 0.9
    assert config.perception.bin_width == 0.1
    with pytest.raises(
        CheckpointError, match=r"on bins=15, bin_width=0\.1 m, .* asks for bins=11,"
    ):
        PolicySource(checkpoint=path).build(EnvConfig(terrain="flat", perception={"bins": 11}))
    stair = {"name": "stair", "rise": -1}
    linear.write(path, terrain="stair", terrain_config=stair)
    with pytest.raises(PolicyError, match=r"terrain\.rise: -1 is not allowed"):
        exported_config(path)


def test_a_terrain_that_is_not_installed_is_named_and_not_needed_on_another(tmp_path: Path) -> None:
    moon = {"terrain": "moon", "terrain_config": {"name": "moon", "craters": 3}}
    robot = {"robot": Robot().model_dump(exclude_none=True)}
    linear.write(tmp_path / "p.onnx", **moon, **robot)
    mix = {"name": "mix", "parts": [{"name": "moon", "craters": 3}, {"name": "step"}]}
    linear.write(tmp_path / "mix.onnx", **robot, terrain="mix", terrain_config=mix)
    for name in ("p.onnx", "mix.onnx"):
        with pytest.raises(PluginError, match="there is no terrain plugin 'moon'; install it or"):
            exported_config(tmp_path / name).terrain.generate(np.random.default_rng(0))
    evaluate = ("eval", "--checkpoint", "mix.onnx", "--episodes", "1")
    done = call(*evaluate, cwd=tmp_path)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert done.err.startswith("error: mix.onnx: there is no terrain plugin 'moon'; install it")
    assert call(*evaluate, "terrain=flat", cwd=tmp_path).code == 0


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
            {"flipper_speed": 0.5},
            r"a decision period of 0\.6 s .* asks for 0\.523599\)",
            "robot.flipper_speed=0.5, or keep the file's period with "
            "randomise.robot.flipper_speed=0.5",
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
    assert line.endswith(f"flipperctl export onnx RUN {export}")
    assert "\n" not in line


APPLIED = {"angle_step", "angle_limit", "control_period"}


def test_what_the_robot_is_like_may_be_overridden(file: Path) -> None:
    build(file, {}, randomise={"robot": {"flipper_speed": [0.3, 0.6]}})  # the decision period stays
    for field in sorted(set(Robot.model_fields) - APPLIED - {"flipper_speed", "flippers"}):
        default = getattr(Robot(), field)
        build(file, {field: 0.05 + 1.01 * (1.0 if default is None else default)})
    assert not APPLIED & Randomise.model_fields.keys()
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
    for command in (evaluate, ("map", "p.onnx", "--over", "sim.friction,sim.gravity")):
        text = refused(*command, "robot.angle_limit=0.9", cwd=tmp_path)
        assert "error: p.onnx applies a limit of 0.3 rad" in text
