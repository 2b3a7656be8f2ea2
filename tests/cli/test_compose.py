"""Composition: sweeps are expanded as Hydra would, and a checkpoint's settings are the defaults."""

import pytest

from flipperctl.cli import compose
from flipperctl.config import TrainConfig, merged, parse


@pytest.fixture(autouse=True)
def defaults() -> None:
    compose.offer_defaults()


def test_every_combination_of_a_sweep_is_composed() -> None:
    found = compose.compose_train(["seed=range(1,4)", "terrain=choice(step,stair)", "device=cpu"])
    assert [(c.seed, c.terrain.plugin_name) for c in found] == [
        (seed, terrain) for seed in (1, 2, 3) for terrain in ("step", "stair")
    ]


def test_an_interval_is_the_sweepers_business() -> None:
    (config,) = compose.compose_train(["agent.gamma=interval(0.9,0.95)"])
    assert config.agent.gamma == 0.99  # the default: no value was drawn


def test_a_checkpoints_settings_are_the_defaults_of_its_evaluation() -> None:
    base = TrainConfig(terrain="stair", network="at_d3qn")
    changes = {"terrain.fewest": 2, "sim.friction": 0.8, "eval.episodes": 7}
    primary = compose.offer_trained(parse(TrainConfig, merged(base, changes)))
    ((same, controller),) = compose.compose_eval([], primary)
    assert controller is None
    assert (same.terrain.model_dump()["fewest"], same.sim.friction, same.eval.episodes) == (
        2,
        0.8,
        7,
    )
    ((other, _),) = compose.compose_eval(["terrain=paper_stair", "sim.friction=0.9"], primary)
    assert other.terrain.plugin_name == "paper_stair"
    assert (other.sim.friction, other.eval.episodes) == (0.9, 7)


def test_the_experiment_wide_stair_takes_in_the_papers_scene() -> None:
    (config,) = compose.compose_train(["experiment=wide_stair"])
    terrain = config.terrain.model_dump()
    assert terrain["most"] == 6
    assert terrain["tread_down"] - terrain["tread_spread"] == pytest.approx(0.2)
