"""A rule that drives some of the training's episodes."""

from pathlib import Path

import numpy as np
import pytest

from flipperctl import plugins
from flipperctl.agent.d3qn import D3qn, arrays
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig, container
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.run.actor import Actor
from flipperctl.run.collect import Order
from flipperctl.run.rollout import play
from tests.short import short_config, trainer


def played(config: TrainConfig, episodes: int) -> list[list[int]]:
    """The actions of a worker's episodes, all on the same ground."""
    agent = D3qn(config.network, config.perception, len(ACTIONS), config.agent, seed=0)
    actor = Actor(container(config), [])
    weights = arrays(agent.online)
    orders = [Order(index, 5, 0.0, 0, 0, {}) for index in range(episodes)]
    return [actor.play(order, weights).actions.tolist() for order in orders]


def test_the_rule_drives_its_share_of_the_episodes() -> None:
    config = short_config(**{"train.guide": "okada", "train.guided": 0.5})
    rule = plugins.create("controller", "okada", "controller")
    env = FlipperEnv(config=config.environment())
    length = play(env, rule, 5)["decisions"]
    (alone,) = played(short_config(), 1)
    episodes = played(config, 12)
    guided = [actions for actions in episodes if actions != alone]
    assert 2 <= len(guided) <= 10
    assert all(actions == guided[0] for actions in guided)
    assert len(guided[0]) == length


def test_without_a_guide_nothing_changes() -> None:
    assert played(short_config(), 2) == played(short_config(**{"train.guided": 1.0}), 2)


def test_an_exact_run_is_guided_too(tmp_path: Path) -> None:
    config = short_config(
        **{
            "train.guide": "level",
            "train.guided": 1.0,
            "train.decisions": 120,
            "agent.learning_starts": 1000,
        }
    )
    run = trainer(config, tmp_path)
    run.run()
    held = run.replay.arrays["action"][: len(run.replay)]
    assert set(np.unique(held).tolist()) <= {0, 1, 3, 4, 5, 7, 8}  # level only returns to 0
    assert (held == 4).mean() > 0.9


def test_an_unknown_guide_is_named() -> None:
    with pytest.raises(ConfigError, match=r"train\.guide.*did you mean 'okada'"):
        short_config(**{"train.guide": "okda"})
