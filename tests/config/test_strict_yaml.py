"""Files in YAML are read as they are written, with one value for a key; booleans are no numbers."""

from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.config import TrainConfig, parse, strict_yaml, with_overrides
from flipperctl.errors import ConfigError
from flipperctl.evaluation.plan import find_suite


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("35", 35), ("035", 35), ("1e3", 1000.0), (".5", 0.5), ("5.", 5.0), ("1.5e-3", 0.0015),
        ("true", True), ("False", False), ("null", None), ("~", None), ("", None),
        ("12:30", "12:30"), ("yes", "yes"), ("off", "off"), ("'35'", "35"), ("!!str 35", "35"),
        ("!!float 3", 3.0), ("inf", "inf"), ("terrain=flat", "terrain=flat"),
    ],
)  # fmt: skip
def test_a_value_is_a_number_a_word_of_yaml_1_2_or_text(text: str, value: object) -> None:
    found = strict_yaml.parse(f"a: {text}", "x")["a"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: 1\nb: 2\na: 3", 'x, line 3: found duplicate key "a" with value "3"'),
        ("'8': 1\n9: 2", "x: a key is a text; write '9' in quotes, not 9"),
        ("a: {b: 1, b: 1}", 'duplicate key "b"'),
        ("? [1]\n: 2", "a key is a text"),
        ("a: &a [*a]", "nested too deeply"),
        ("a: !!python/object:os.x 3", "could not determine a constructor"),
        ("a: " + 5000 * "9", "no YAML: Exceeds the limit"),
        ("[" * 1000, "nested too deeply"),
        ("a: 1\n--- \na: 2", "another document"),
    ],
)
def test_what_is_ambiguous_is_refused(text: str, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        strict_yaml.parse(text, "x")


def test_scenes_have_the_names_that_are_written(tmp_path: Path) -> None:
    names = ["'010'", "yes", "on", "'1.0'", "'1'", "12:30"]
    file = tmp_path / "mine.yaml"
    file.write_text("scenes:\n" + "".join(f"  {name}: terrain=flat\n" for name in names))
    scenes = find_suite(str(file)).scenes
    assert [scene.name for scene in scenes] == [name.strip("'") for name in names]
    file.write_text("scenes: {dry: sim.friction=1, wet: sim.friction=0.6, dry: sim.friction=0.4}")
    with pytest.raises(ConfigError, match=r'line 1: found duplicate key "dry"'):
        find_suite(str(file))


def test_a_boolean_is_no_number() -> None:
    config = parse(TrainConfig, {"terrain": "step", "network": "at_d3qn"})
    for change in ({"agent.n_step": np.False_}, {"robot.payload": True}):
        with pytest.raises(ConfigError, match="a number is allowed, not true or false"):
            with_overrides(config, change)
    assert with_overrides(config, {"train.record": True}).train.record
    assert Robot(payload=1).payload == 1.0
