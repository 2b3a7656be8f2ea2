"""Python values as overrides, each worked by hand, and what Hydra reads in them."""

from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from flipperctl_plugins.terrains.obstacles import Step

from flipperctl.api import Range
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.errors import ConfigError
from flipperctl.scripting.settings import literal, words


class Kind(Enum):
    ONE = "one"


WRITTEN = [
    (True, "true"),
    (np.bool_(False), "false"),
    (3, "3"),
    (1e-5, "1e-05"),
    (np.float64(0.5), "0.5"),
    (float("inf"), "inf"),
    ("stair", "stair"),
    ("3", '"3"'),
    ("null", '"null"'),
    ("True", '"True"'),
    ("key=value", '"key=value"'),
    ('say "hi"', r'"say \"hi\""'),
    ("end\\", r'"end\\"'),
    (r"\"", r'"\\\""'),
    (Path("runs/a b"), '"runs/a b"'),
    (Kind.ONE, "one"),
    ((1, "x y"), '[1,"x y"]'),
    (np.array([[0.5, 1.0]]), "[[0.5,1.0]]"),
    ([{"name": "stair", "low": None}], "[{name:stair,low:null}]"),
]


def test_the_rewards_of_a_controller_are_one_setting() -> None:
    terms = {"swing": {"name": "swing", "weight": 3}, "end": "end"}
    written = "controller.rewards={swing:{name:swing,weight:3},end:end}"
    assert words({"controller": {"rewards": terms}}) == [written]
    assert words({"controller": {"rewards": "smooth"}}) == ["controller.rewards=smooth"]
    assert words({"rewards": {"swing": {"weight": 3}}}) == ["rewards.swing.weight=3"]


@pytest.mark.parametrize(("value", "written"), WRITTEN, ids=[repr(value) for value, _ in WRITTEN])
def test_a_value_is_written_so_that_hydra_reads_it_again(value: object, written: str) -> None:
    assert literal(value, "key") == written
    read = Overrides.parse([f"key={written}"], check=False).parsed[0].value()
    plain = value.value if isinstance(value, Enum) else value
    if isinstance(plain, np.ndarray | np.generic):
        plain = plain.tolist()
    elif isinstance(plain, Path):
        plain = str(plain)
    elif isinstance(plain, tuple):
        plain = list(plain)
    assert read == plain
    assert type(read) is type(plain)


@pytest.mark.parametrize("value", [object(), {1, 2}, [{"two words": 1}], 1j, b"bytes"])
def test_a_value_without_a_form_is_refused_with_its_key(value: object) -> None:
    with pytest.raises(ConfigError, match=r"^train\.x: "):
        words({"train": {"x": value}})


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"terrain": "stair"}, ["terrain=stair"]),
        ({"terrain": ["stair", "step"]}, ["terrain=stair,step"]),
        ({"terrain": {"name": "stair", "rise": 0.1}}, ["terrain=stair", "terrain.rise=0.1"]),
        ({"terrain": {"height": (0.1, 0.2)}}, ["terrain.height=[0.1,0.2]"]),
        ({"logger": ["csv", "wandb"]}, ["logger=[csv,wandb]"]),
        ({"train": {"decisions": 5, "mode": "exact"}}, ["train.decisions=5", "train.mode=exact"]),
        ({"rewards.swing.weight": 4}, ["rewards.swing.weight=4"]),
        ({"randomise": {"sim.yaw": [-0.1, 0.1]}}, ["randomise.sim.yaw=[-0.1,0.1]"]),
        ({"rewards": {"travel": None}}, ["~rewards.travel"]),
        ({"rewards": {}}, ["~rewards"]),
        ({"+reward@rewards.energy": "energy"}, ["+reward@rewards.energy=energy"]),
        ({"experiment": None}, ["experiment=null"]),
    ],
)
def test_keyword_arguments_are_overrides(settings: dict, expected: list[str]) -> None:
    assert words(settings, ["seed=2"]) == [*expected, "seed=2"]


def test_the_settings_of_a_plugin_may_be_an_object() -> None:
    found = words({"terrain": Step(height=Range(0.1, 0.2))})
    assert found[0] == "terrain=step"
    assert "terrain.height=[0.1,0.2]" in found


@pytest.mark.parametrize(
    "settings", [{"terrain": ["stair", {"name": "step"}]}, {"conditions": [None]}]
)
def test_a_list_of_choices_holds_names(settings: dict) -> None:
    with pytest.raises(ConfigError, match="names are allowed in a list"):
        words(settings)


def test_overrides_are_a_list() -> None:
    with pytest.raises(ConfigError, match="a list of words is allowed"):
        words({}, "seed=1")
