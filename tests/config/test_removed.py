"""Settings of earlier versions: left out at their last value, refused at another one."""

from pathlib import Path
from typing import Any

import pytest

from flipperctl.config import EvalConfig, TrainConfig, parse, resolver, to_dict
from flipperctl.errors import ConfigError
from tests.cli.call import refused


def test_a_setting_that_is_gone_is_left_out_at_its_last_value() -> None:
    config = parse(TrainConfig, to_dict(TrainConfig(terrain="flat", network="mlp", sim="mujoco")))
    plain = to_dict(config)
    plain["sim"] |= {"roll_gain": 0.0, "ground_width": 4.0, "rotor_inertia": 1.0}
    plain["agent"] |= {"act_with": "target"}
    plain["agent"]["policy_gradient"] |= {"value_rate": 0.001, "value_passes": 8}
    assert parse(TrainConfig, plain) == config
    mpc = resolver.create("controller", {"name": "mpc", "averaging": 0.5}, "controller")
    assert mpc == resolver.create("controller", "mpc", "controller")


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"sim": {"name": "mujoco", "roll_gain": 1.0}}, "sim: roll_gain is gone; its value was 0"),
        ({"perception": {"name": "lidar", "wander_time": 5}}, "gone; its value was 30.0; it is 5"),
    ],
)
def test_another_value_is_refused(changed: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        parse(EvalConfig, {"terrain": "flat", **changed})


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("train agent.act_with=online", "agent.act_with is gone; its value was target\n"),
        ("train agent.policy_gradient.value_passes=8", "value_passes is gone; its value was 8\n"),
        ("eval mpc controller.averaging=0", "controller.averaging is gone; its value was 0.5\n"),
        ("eval okada sim=mujoco sim.roll_gain=1", "sim.roll_gain is gone; its value was 0.0\n"),
    ],
)
def test_an_override_says_that_the_setting_is_gone(words: str, text: str, tmp_path: Path) -> None:
    assert text in refused(*words.split(), cwd=tmp_path)
