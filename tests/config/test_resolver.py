"""From names and overrides to settings: every way in gives the same settings, or the same words."""

from typing import Any

import pytest

from flipperctl.config import (
    EnvConfig,
    Teacher,
    TrainConfig,
    parse,
    resolver,
    to_dict,
    with_overrides,
)
from flipperctl.config.models import with_stand_ins
from flipperctl.errors import ConfigError
from tests.short import short_config

PLAIN = to_dict(TrainConfig(terrain="flat", network="mlp"))
STAIR = EnvConfig(terrain="stair")
GRADIENT = {"agent": "policy_gradient", "agent.decisions": 100, "agent.warm_up": 2}
OKADA = {"teacher.controller": {"name": "okada"}, "teacher.td_weight": 0.0}


def logged(overrides: dict[str, Any]) -> TrainConfig:
    return with_overrides(parse(TrainConfig, PLAIN), overrides)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda: resolver.get("terrain", "stairs", "terrain"),
            r"^terrain: there is no terrain plugin 'stairs' .did you mean 'stair'\?.*paper_step",
        ),
        (
            lambda: resolver.create("terrain", {"name": "mix", "parts": ["stiar"]}, "terrain"),
            r"^terrain\.parts\.0: there is no terrain plugin 'stiar' .did you mean 'stair'\?.*step",
        ),
        (lambda: resolver.create("terrain", "mine", "terrain"), "loaded by --plugins FILE"),
        (lambda: resolver.create("terrain", {"rise": 0.1}, "terrain"), "a mapping with 'name'"),
        (
            lambda: with_overrides(STAIR, {"terrain.rise.x": 1}),
            r"terrain\.rise\.x: rise is a value, not a section",
        ),
        (lambda: parse(Teacher, {"temperature": 1e-323}), r"is not allowed \(≥ 1e-06, ≤ 1000 s\)"),
        (lambda: logged({"logger": "wandbb"}), r"logger\.wandbb: .*did you mean 'wandb'"),
        (
            lambda: logged({"logger.wandb.project": "x"}),
            r"logger\.wandb: .*chosen: tensorboard; logger=wandb",
        ),
        (lambda: logged({"logger": 3}), "logger: names, or a mapping"),
        (
            lambda: logged({"logger": {"../x": {"name": "wandb"}}}),
            r"logger\.\.\./x: lower-case letters",
        ),
    ],
)
def test_a_wrong_setting_says_what_is_allowed(call: Any, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        call()


def test_a_plugins_container_makes_an_equal_plugin() -> None:
    mix = resolver.create("terrain", {"name": "mix", "parts": ["flat", "step"]}, "terrain")
    assert resolver.create("terrain", to_dict(mix), "terrain") == mix
    assert to_dict(mix, brief=True)["parts"] == ["flat", "step"]
    assert [p.plugin_name for p in resolver.nested_plugins(mix)] == ["mix", "flat", "step"]


def test_nested_and_dotted_overrides_and_a_whole_container_make_the_same_settings() -> None:
    dotted = with_overrides(STAIR, {"terrain.rise": 0.1, "rewards.pitch.window": 4})
    nested = with_overrides(STAIR, {"terrain": {"rise": 0.1}, "rewards": {"pitch": {"window": 4}}})
    assert dotted == nested == parse(EnvConfig, to_dict(nested))
    assert dotted != STAIR
    found = with_overrides(STAIR, {"rewards.pitch": None, "rewards.hit": "impact"})
    assert set(found.rewards) == {"flipper", "end", "hit"}
    assert with_overrides(STAIR, {"rewards": {}}).rewards == {}


@pytest.mark.parametrize(
    ("named", "field"),
    [
        ({"sim": "mujoco"}, "friction"),
        ({"sim": {"name": "mujoco"}}, "friction"),
        ({"robot": "absolem"}, "track_speed"),
    ],
)
def test_fields_of_what_is_named_count_in_any_order(named: dict[str, object], field: str) -> None:
    (section,) = named
    change = {f"{section}.{field}": 0.31}
    found = [with_overrides(STAIR, pair) for pair in ({**named, **change}, {**change, **named})]
    assert found[0] == found[1] != with_overrides(STAIR, named)
    assert getattr(getattr(found[0], section), field) == 0.31


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ("wandb", ["wandb"]),
        (["tensorboard", "wandb"], ["tensorboard", "wandb"]),
        ("csv", []),
        ({}, []),
        ({"second": {"name": "wandb", "mode": "offline"}}, ["second"]),
    ],
)
def test_loggers_are_chosen_by_name(given: Any, names: list[str]) -> None:
    assert list(parse(TrainConfig, {**PLAIN, "logger": given}).logger) == names


def test_a_resumed_run_may_have_other_loggers() -> None:
    both = logged({"logger": ["csv", "wandb"], "logger.wandb.project": "stairs"})
    assert to_dict(both)["logger"]["wandb"]["project"] == "stairs"
    assert list(both.logger) == ["wandb"]
    later = logged({"logger.wandb.project": "stairs", "logger": ["csv", "wandb"]})
    assert later.logger == both.logger
    one = with_overrides(both, {"logger.wandb.mode": "offline"})
    assert to_dict(one)["logger"]["wandb"] == to_dict(both)["logger"]["wandb"] | {"mode": "offline"}
    mine = {"mine": {"name": "mine", "server": "here"}, **PLAIN["logger"]}  # its plugin is missing
    assert with_stand_ins({**PLAIN, "logger": mine}, {})["logger"] == PLAIN["logger"]


@pytest.mark.parametrize(
    ("settings", "decisions", "words"),
    [
        ({"agent.learning_starts": 500}, 499, "after agent.learning_starts=500 decisions"),
        ({"agent.learning_starts": 500}, 500, ""),
        ({"agent.learning_starts": 500, "teacher.final_updates": 5, **OKADA}, 499, ""),
        (GRADIENT, 299, "it learns from 300 decisions on"),
        (GRADIENT, 300, ""),
    ],
)
def test_the_first_update_is_stated(settings: dict[str, Any], decisions: int, words: str) -> None:
    config = short_config(**{**settings, "train.decisions": decisions})
    first = config.agent.first_update(config)
    assert (first is not None and decisions < first[0]) == bool(words)
    assert first is None or words in first[1]
