"""The choice of loggers: by names, with settings, and without their plugins."""

from typing import Any

import pytest

from flipperctl.config import TrainConfig, parse, to_dict, with_overrides
from flipperctl.config.absent import with_stand_ins
from flipperctl.errors import ConfigError

PLAIN = to_dict(TrainConfig(terrain="flat", network="mlp"))


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ("wandb", ["wandb"]),
        (["tensorboard", "wandb"], ["tensorboard", "wandb"]),
        ("csv", []),
        ([], []),
        ({}, []),
        ({"second": {"name": "wandb", "mode": "offline"}}, ["second"]),
    ],
)
def test_loggers_are_chosen_by_name(given: Any, names: list[str]) -> None:
    assert list(parse(TrainConfig, {**PLAIN, "logger": given}).logger) == names


def test_a_resumed_run_may_have_other_loggers() -> None:
    config = parse(TrainConfig, PLAIN)
    both = with_overrides(config, {"logger": ["csv", "wandb"], "logger.wandb.project": "stairs"})
    assert to_dict(both)["logger"]["wandb"]["project"] == "stairs"
    assert list(both.logger) == ["wandb"]
    later = with_overrides(config, {"logger.wandb.project": "stairs", "logger": ["csv", "wandb"]})
    assert later.logger == both.logger
    one = with_overrides(both, {"logger.wandb.mode": "offline"})
    assert to_dict(one)["logger"]["wandb"] == to_dict(both)["logger"]["wandb"] | {"mode": "offline"}


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"logger": "wandbb"}, r"logger\.wandbb: .*did you mean 'wandb'"),
        ({"logger.wandb.project": "x"}, r"logger\.wandb: .*chosen: tensorboard; logger=wandb"),
        ({"logger": "trackio"}, r"logger\.trackio: .*'trackio'; it is gone: logger=wandb"),
        ({"logger": 3}, "logger: names, or a mapping"),
        ({"logger": {"../x": {"name": "wandb"}}}, r"logger\.\.\./x: lower-case letters"),
    ],
)
def test_a_wrong_choice_says_what_is_allowed(overrides: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        with_overrides(parse(TrainConfig, PLAIN), overrides)


def test_a_policy_is_judged_without_the_plugins_of_its_loggers() -> None:
    mine = {"mine": {"name": "mine", "server": "here"}, **PLAIN["logger"]}
    assert with_stand_ins({**PLAIN, "logger": mine}, {})["logger"] == PLAIN["logger"]
