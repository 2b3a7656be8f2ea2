"""Robots by name and from files."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from flipperctl.api import Robot
from flipperctl.config import EnvConfig
from flipperctl.config.defaults import notes_on_robot
from flipperctl.config.presets import presets
from flipperctl.config.resolver import named_robot
from flipperctl.errors import ConfigError
from flipperctl.export.policy import robot_fields
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from tests.cli.call import call, refused

PRESETS = Path(__file__).parents[2] / "configs/robot"


@pytest.mark.parametrize("name", presets("robot"))
def test_a_preset_states_every_setting(name):
    stated = yaml.safe_load((PRESETS / f"{name}.yaml").read_text(encoding="utf-8"))
    assert set(stated) == set(Robot.model_fields)  # Hydra overrides only keys that exist
    assert (named_robot(name) == Robot()) == (name == "nubot")
    robot = named_robot("absolem")  # whose reach is the published one
    assert 2 * robot.hinge_offset == pytest.approx(0.5)  # distance of the axles
    assert robot.flipper_axle + robot.track_radius == pytest.approx(0.33 + 0.029)
    assert robot.chassis_mass + 2 * robot.flipper_mass == pytest.approx(38)
    assert robot.decision_period == pytest.approx(1 / 3)


def test_a_file_becomes_settings_that_other_words_win_over(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("chassis_length: 0.7\ntrack_speed: 0.3\n")
    words = from_words([f"robot={file}", "terrain=step", "robot.track_speed=0.1"]).words
    assert "robot.chassis_length=0.7" in words
    assert "robot.control_period=null" in words
    assert "robot.flipper_length=0.536" in words
    assert [word for word in words if "track_speed" in word] == ["robot.track_speed=0.1"]
    assert len(words) == len(Robot.model_fields) + 1


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("chassis_lenght: 0.7", "mine.yaml.chassis_lenght: there is no such key .did you mean"),
        ("track_radius: 3", "mine.yaml.track_radius: 3 is not allowed .*< 0.5 m"),
        ("track_radius: 0.4", r"mine.yaml: chassis_length \(0.76 m\) must exceed twice"),
        ("- 1", "mine.yaml: settings of the robot are allowed"),
        ("flipper_speed: yes", r"mine\.yaml\.flipper_speed: .*number"),
    ],
)
def test_an_error_names_the_file_the_key_and_what_is_allowed(tmp_path, text, error):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=error):
        from_words([f"robot={file}"]).words  # noqa: B018


def test_unknown_robots_and_lists_of_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"absent.yaml cannot be read: No such file"):
        from_words(["robot=absent.yaml"]).words  # noqa: B018
    with pytest.raises(ConfigError, match="one file is allowed"):
        from_words(["robot=a.yaml,b.yaml"]).words  # noqa: B018
    with pytest.raises(ConfigError, match="did you mean 'absolem'"):
        named_robot("absolen")
    assert "known: absolem, nubot" in refused("inspect", "config", "robot=absolen", cwd=tmp_path)
    (tmp_path / "mine.yaml").write_text("chassis_length: 0.7\n")
    done = call("inspect", "config", "robot=mine.yaml", cwd=tmp_path)
    assert Robot(**yaml.safe_load(done.out)["robot"]) == Robot(chassis_length=0.7)


def test_a_policy_is_evaluated_and_exported_for_another_robot(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("chassis_length: 0.7\n")
    for name in ("absolem", str(file)):
        ((config, _),) = scenes(
            from_words([f"robot={name}", "terrain=flat"]), Path("generalist"), None
        )
        assert config.robot == named_robot(name)
        assert Robot(**robot_fields({"robot": name})) == named_robot(name)
    fields = robot_fields({"robot": "absolem", "robot.track_speed": 0.1})
    assert Robot(**fields) == named_robot("absolem").model_copy(update={"track_speed": 0.1})


def test_conditions_for_nubot_are_remarked_on():
    ranges: Any = {"robot": {"flipper_length": (0.52, 0.552), "chassis_mass": (30, 40)}}
    assert not list(notes_on_robot(EnvConfig(terrain="flat", randomise=ranges)))
    (note,) = notes_on_robot(EnvConfig(terrain="flat", randomise=ranges, robot="absolem"))
    assert "robot.flipper_length=0.448" in note
