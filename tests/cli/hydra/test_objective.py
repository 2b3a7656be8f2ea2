"""The objective of a search, and what it refuses to compare."""

from pathlib import Path

import pytest

from flipperctl.cli.hydra import optuna_search
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.errors import ConfigError
from flipperctl.training.search_space import objective
from tests.cli.call import refused


def test_the_objective_orders_by_success_and_then_by_swing_at_100_hz() -> None:
    def value(success: float, swing: float, at_decisions: float = 0.0) -> float:
        best = {
            "success_rate": success,
            "pitch_variation": at_decisions,
            "pitch_variation_100hz": swing,
        }
        found = objective(best, 40)
        assert found is not None
        return found

    assert value(1.0, 1.0) == pytest.approx(1 - 0.5 / 40)
    assert value(1.0, 0.0) == 1
    assert value(1.0, 0.5) > value(1.0, 1.0) > value(39 / 40, 0.0) > value(38 / 40, 0.0)
    assert value(1 / 40, 1e6) > value(0.0, 0.0)
    assert value(1.0, 1.0, at_decisions=0.9) == value(1.0, 1.0, at_decisions=0.1)
    assert objective(None, 40) is None


def test_the_objective_is_the_return_where_runs_choose_by_it() -> None:
    best = {"success_rate": 1.0, "pitch_variation_100hz": 0.5, "mean_return": 7.0}
    assert objective(best, 40, "return") == 7.0
    assert objective(best, 40, "last") == objective(best, 40) == objective(best, 40, "success")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["train.best_by=success,return"], "train.best_by: a search has one objective"),
        (
            ["rewards=smooth", "rewards.swing.weight=interval(2,16)", "train.best_by=return"],
            "rewards.swing.weight: a search by returns",
        ),
        (["rewards=paper,smooth", "experiment=searched"], "rewards: a search by returns"),
        (
            ["+reward@rewards.more=progress,impact", "train.best_by=return"],
            r"\+reward@rewards.more: a search by returns",
        ),
        (["rewards=paper,smooth", "experiment=quick,searched"], "rewards: a search by returns"),
        (["experiment=quick,searched"], "experiment=searched: a search has one objective"),
        (["train.validation_seed=1,2,3"], "train.validation_seed: a search has one objective"),
        (["++train.validation_seed=interval(1,9)"], "train.validation_seed: a search has one"),
    ],
)
def test_objectives_that_do_not_compare_are_refused(words: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        optuna_search._check_objective(*Overrides.parse(words, check=False).sampled())


def test_lists_that_need_each_other_are_composed_together() -> None:
    words = ["network=mlp,dueling_mlp", "network.hidden=[16],[32]"]
    optuna_search._check_objective(*Overrides.parse(words, check=False).sampled())


def test_the_command_refuses_them(tmp_path: Path) -> None:
    """Within the application of Hydra, which composes otherwise than a test does."""
    words = ("rewards.pitch.weight=0.1,1", "train.best_by=return")
    error = refused("train", "-m", "hydra/sweeper=optuna", *words, cwd=tmp_path)
    assert "rewards.pitch.weight: a search by returns" in error


def test_rewards_are_searched_by_success() -> None:
    words = ["rewards=smooth", "rewards.swing.weight=interval(2,16)"]
    optuna_search._check_objective(*Overrides.parse(words, check=False).sampled())
