"""The files that controllers name: where they are, and errors that begin with the setting."""

from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl.api import Robot
from flipperctl.config import EnvConfig
from flipperctl.errors import CheckpointError
from flipperctl.policies.source import PolicySource
from flipperctl.policies.values import learned_value, value_of
from tests.short import short_config

VALUE = "controller.value"


def test_a_run_is_found_from_the_working_directory(
    short_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(short_run.parent)
    whole = learned_value(str(short_run), VALUE)
    observations = np.zeros((2, whole.layout.size), np.float32)
    expected = whole.value(observations)
    assert expected.shape == (2,)
    for name in (short_run.name, f"{short_run.name}/checkpoints/best.safetensors"):
        assert learned_value(name, VALUE).value(observations) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("rum", None, "there is no such run, file or shipped policy"),
        ("generalis", None, "did you mean 'generalist'"),
        ("exported.onnx", "", "an exported file holds no training"),
        ("damaged.safetensors", "nothing", "is damaged or not a safetensors file"),
        ("generalist", None, "a network of one observation is allowed"),
    ],
)
def test_a_wrong_file_is_named_with_the_setting(
    name: str, content: str | None, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(name).write_text(content)
    source = PolicySource(settings={"name": "mpc", "value": name})
    with pytest.raises(CheckpointError, match=rf"^controller\.value[:=].*{name}.*{text}"):
        source.build(EnvConfig(terrain="step"))


def test_the_policy_of_a_planner_is_named_too() -> None:
    source = PolicySource(settings={"name": "planner", "policy": "nowhere"})
    with pytest.raises(CheckpointError, match=r"^controller\.policy: nowhere: there is no such"):
        source.build(EnvConfig(terrain="step"))


def test_robots_of_sampled_sizes_are_those_of_the_training() -> None:
    config = short_config(**{"randomise.robot.size": [0.6, 1.4]})
    value = value_of(torch.nn.Identity(), config)
    for size, fits in ((0.62, True), (1.0, True), (1.38, True), (0.5, False), (1.6, False)):
        robot = config.robot.model_copy(
            update={name: size * getattr(config.robot, name) for name in Robot.factors["size"]}
        )
        assert (not list(value.misfits(robot, config.perception.layout))) is fits
