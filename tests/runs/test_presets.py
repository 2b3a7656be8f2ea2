"""Presets give a program the configuration that the same overrides give a command."""

import pytest

from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import container
from flipperctl.errors import ConfigError
from flipperctl.runs import presets

CHOICES = [
    {"experiment": "generalist"},
    {"experiment": "taught_annealed", "terrain": "ramp", "conditions": "varied"},
    {"rewards": "smooth", "network": "mlp", "teacher": "okada"},
]


@pytest.fixture(autouse=True)
def defaults() -> None:
    config_store.register_defaults()


def overrides(choices: dict[str, str]) -> Overrides:
    return Overrides.parse([f"{group}={name}" for group, name in choices.items()])


@pytest.mark.parametrize("choices", CHOICES)
def test_a_training_is_that_of_the_command(choices: dict[str, str]) -> None:
    (composed,) = compose.compose_train(overrides(choices))
    assert container(presets.train_config(choices)) == container(composed)


def test_an_evaluation_is_that_of_the_command_with_its_changes() -> None:
    choices = {"terrain": "plum", "conditions": "wide", "rewards": "tuned"}
    ((composed, _),) = compose.compose_eval(overrides(choices))
    assert container(presets.eval_config(choices)) == container(composed)
    assert presets.eval_config(choices, {"eval.episodes": 7}).eval.episodes == 7


@pytest.mark.parametrize(
    "choices", [{"conditions": "trained", "terrain": "plum"}, {"conditions": "wide"}]
)
def test_a_policy_brings_to_a_program_what_it_brings_to_the_command(
    choices: dict[str, str],
) -> None:
    changes = {"perception.bins": 21, "sim.friction": 0.8, "robot.chassis_mass": 60}
    trained = presets.train_config({"conditions": "varied"}, changes)
    primary = config_store.register_trained(trained)
    ((composed, _),) = compose.compose_eval(overrides(choices), primary)
    assert container(presets.policy_config(trained, choices)) == container(composed)


@pytest.mark.parametrize(
    ("choices", "match"),
    [
        ({"terain": "ramp"}, "did you mean 'terrain'"),
        ({"terrain": "stiar"}, "did you mean 'stair'"),
        ({"conditions": "wid"}, "did you mean 'wide'"),
    ],
)
def test_a_wrong_choice_names_a_close_match(choices: dict[str, str], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        presets.train_config(choices)
