"""One request, typed or from Python: both doors make the same configuration and the same plan."""

from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flipperctl_plugins.terrains.obstacles import Step

from flipperctl.api import Range
from flipperctl.config import to_dict
from flipperctl.errors import ConfigError
from flipperctl.evaluation.plan import NamedPolicy
from flipperctl.requests.compose import compose_train
from flipperctl.requests.plan import make_plan
from flipperctl.requests.request import Requests, from_values
from flipperctl.requests.text import from_words
from flipperctl.scripting.settings import requested


class Kind(Enum):
    ONE = "one"


def values(settings: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(request.name, request.value) for request in from_values(settings)]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (np.float64(0.5), "0.5"),
        (Path("runs/a b"), '"runs/a b"'),
        (1e-5, "1e-05"),
        ("3", '"3"'),
        ("null", '"null"'),
        ('say "hi"', r'"say \"hi\""'),
        (r"\"", r'"\\\""'),
        (Kind.ONE, "one"),
        ((1, "x y"), '[1,"x y"]'),
        (np.array([[0.5, 1.0]]), "[[0.5,1.0]]"),
        ([{"name": "stair", "low": None}], "[{name:stair,low:null}]"),
    ],
    ids=repr,
)
def test_the_word_of_a_value_has_the_value(value: object, text: str) -> None:
    (request,) = from_values({"key": value})
    assert request.text == f"key={text}"
    (again,) = from_words([request.text])
    assert again.value == request.value
    assert type(again.value) is type(request.value)


@pytest.mark.parametrize("value", [object(), {1, 2}, 1j, b"bytes"])
def test_a_value_that_is_no_setting_is_refused_with_its_key(value: object) -> None:
    with pytest.raises(ConfigError, match=r"^train\.x: "):
        list(from_values({"train": {"x": value}}))


TRAININGS: list[tuple[dict[str, Any], list[str]]] = [
    ({"terrain": {"name": "stair", "rise": 0.1}}, ["terrain=stair", "terrain.rise=0.1"]),
    ({"terrain": Step(height=Range(0.1, 0.2))}, ["terrain=step", "terrain.height=[0.1,0.2]"]),
    (
        {"experiment": "quick", "rewards": "paper", "conditions": "wide"},
        ["experiment=quick", "rewards=paper", "conditions=wide"],
    ),
    ({"logger": ["csv", "wandb"]}, ["logger=[csv,wandb]"]),
    (
        {"train": {"decisions": 5000, "mode": "exact"}, "rewards.swing.weight": 4},
        ["train={decisions: 5000, mode: exact}", "rewards.swing.weight=4"],
    ),
    ({"sim": "mujoco", "randomise": {"sim.yaw": 0.1}}, ["sim=mujoco", "randomise.sim.yaw=0.1"]),
    ({"rewards": {"travel": None}}, ["~rewards.travel"]),
    (
        {"+reward@rewards.hit": "impact", "rewards.calm": "time"},
        ["+reward@rewards.hit=impact", "rewards.calm=time"],
    ),
    (
        {"agent": "sb3", "agent.algorithm": "dqn", "agent.settings": {"tau": 0.5}},
        ["agent=sb3", "agent.algorithm=dqn", "agent.settings.tau=0.5"],
    ),
    (
        {"logger": "wandb", "logger.wandb.project": "${seed}"},
        ["logger=wandb", r"logger.wandb.project='\${seed}'"],
    ),
]


@pytest.mark.parametrize(("settings", "words"), TRAININGS, ids=lambda part: str(part)[:40])
def test_a_training_is_the_same_by_both_doors(settings: dict[str, Any], words: list[str]) -> None:
    (python,), (typed,) = compose_train(requested(settings, ())), compose_train(from_words(words))
    assert to_dict(python) == to_dict(typed)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"terrain": ["stair", "step"]}, ["terrain=stair,step"]),
        (
            {"suite": "paper", "eval.episodes": 3, "terrain": "step"},
            ["suite=paper", "eval.episodes=3", "terrain=step"],
        ),
        ({"sim": ["planar", "mujoco"], "terrain": "step"}, ["sim=planar,mujoco", "terrain=step"]),
        (
            {"controller": {"rewards": {"swing": {"name": "swing", "weight": 3}, "end": "end"}}},
            ["controller.rewards={swing:{name:swing,weight:3},end:end}"],
        ),
    ],
)
def test_a_plan_is_the_same_by_both_doors(settings: dict[str, Any], words: list[str]) -> None:
    def plan(requests: Requests) -> Any:
        return make_plan(requests, [NamedPolicy("mpc")], None, lambda line: None)

    assert plan(requested(settings, ())) == plan(from_words(words))


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"terrain": "stiar"}, "terrain=stiar"),
        ({"train": {"decisons": 5}}, "train.decisons=5"),
        ({"terrain": 3}, "terrain=3"),
    ],
)
def test_a_wrong_request_is_refused_alike_by_both_doors(settings: dict, word: str) -> None:
    texts = []
    for requests in (requested(settings, ()), from_words([word])):
        with pytest.raises(ConfigError) as refused:
            compose_train(requests)
        texts.append(str(refused.value))
    assert texts[0] == texts[1]


def test_the_rewards_of_a_controller_are_one_setting() -> None:
    terms = {"swing": {"name": "swing", "weight": 3}, "end": "end"}
    assert values({"controller": {"rewards": terms}}) == [("controller.rewards", terms)]
    assert values({"rewards": {"swing": {"weight": 3}}}) == [("rewards.swing.weight", 3)]
    assert values({"rewards": {}}) == [("~rewards", None)]


@pytest.mark.parametrize(
    "settings", [{"terrain": ["stair", {"name": "step"}]}, {"conditions": [None]}]
)
def test_a_list_of_choices_holds_names(settings: dict) -> None:
    with pytest.raises(ConfigError, match="names are allowed in a list"):
        list(from_values(settings))


def test_words_follow_keyword_arguments() -> None:
    requests = requested({"terrain": "stair"}, ["seed=2"])
    assert [request.text for request in requests] == ["terrain=stair", "seed=2"]
    with pytest.raises(ConfigError, match="a list of words is allowed"):
        requested({}, "seed=1")
