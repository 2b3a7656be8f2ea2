"""``controller.rewards=PRESET``: the preset's name becomes its reward terms."""

from pathlib import Path
from typing import Any

import pytest
from hydra.core.config_store import ConfigStore

import flipperctl
from flipperctl.cli.hydra import compose
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.reward_scenes import policies
from flipperctl.config import to_dict
from flipperctl.errors import ConfigError
from tests.cli.call import EXACT, call


def controller_of(*words: str) -> dict[str, Any]:
    ((_, settings),) = compose.compose_eval(Overrides.parse(["controller=mpc", *words]))
    assert settings is not None
    return settings


def preset(name: str) -> dict[str, Any]:
    config = compose.compose_environment(Overrides.parse([f"rewards={name}"]))
    return {term: to_dict(settings) for term, settings in config.rewards.items()}


@pytest.mark.parametrize("name", ["paper", "tuned", "smooth"])
def test_the_preset_is_that_of_the_environment(name: str) -> None:
    own = compose.with_preset({"name": "mpc", "rewards": name}, "controller")
    assert own["rewards"] == preset(name)
    assert controller_of(f"controller.rewards={name}", "rewards=paper")["rewards"] == preset(name)


def test_null_and_a_mapping_of_terms_stay() -> None:
    assert controller_of("controller.rewards=null")["rewards"] is None
    swing = {"name": "swing", "weight": 3}
    found = controller_of("controller.rewards={swing:{name:swing,weight:3}}")
    assert found["rewards"] == {"swing": swing}


def test_each_value_of_a_list_is_a_scene_of_its_own() -> None:
    words = Overrides.parse(["controller=mpc", "controller.rewards=paper,smooth"])
    found = [(settings or {})["rewards"] for _, settings in compose.compose_eval(words)]
    assert found == [preset("paper"), preset("smooth")]


def test_a_preset_of_a_plugin_counts() -> None:
    terms = {"calm": {"name": "travel", "weight": 2.0}}
    ConfigStore.instance().store(group="rewards", name="calm_one", node=terms, package="rewards")
    try:
        assert controller_of("controller.rewards=calm_one")["rewards"] == terms
    finally:
        del ConfigStore.instance().repo["rewards"]["calm_one.yaml"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["controller=mpc", "controller.rewards=smoth"], r"controller.rewards: .*'smoth'; did you"),
        (["controller=okada", "controller.rewards=smooth"], "controller.rewards: there is no such"),
    ],
)
def test_what_cannot_be_is_refused(words: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        compose.compose_eval(Overrides.parse(words))


def test_a_teacher_has_presets_with_the_discount_of_the_training() -> None:
    words = ["teacher=mpc", "teacher.controller.rewards=smooth", "agent.gamma=0.9"]
    (config,) = compose.compose_train(Overrides.parse(words))
    controller = to_dict(config)["teacher"]["controller"]
    assert controller["rewards"]["shaped_progress"]["gamma"] == 0.9
    assert list(controller["rewards"]) == list(preset("smooth"))
    wrong = Overrides.parse(["teacher=mpc", "teacher.controller.rewards=smoth"])
    with pytest.raises(ConfigError, match=r"teacher.controller.rewards: .*'smooth'"):
        compose.compose_train(wrong)


def test_compared_controllers_with_that_field_have_the_preset() -> None:
    sources, others = policies("level,mpc", ["controller.rewards=tuned", "terrain=step"])
    assert (sources["mpc"].settings or {})["rewards"] == preset("tuned")
    assert "rewards" not in (sources["level"].settings or {})
    assert others.words == ["terrain=step"]
    with pytest.raises(ConfigError, match=r"controller.rewards: .*'tune'; did you mean 'tuned'"):
        policies("level,mpc", ["controller.rewards=tune"])


def test_a_preset_of_a_configuration_folder_counts_in_a_training(tmp_path: Path) -> None:
    """The terms are found; then ``mpc`` refuses to be paid by them without a value."""
    own = tmp_path / "own" / "rewards"
    own.mkdir(parents=True)
    (own / "mine.yaml").write_text("defaults:\n  - /reward@swing: swing\n")
    words = [f"{key}={value}" for key, value in EXACT.items()]
    for name, text in (("mine", "set controller.value"), ("mime", "'mime'; did you mean 'mine'")):
        teacher = ["teacher=mpc", f"teacher.controller.rewards={name}"]
        done = call("train", "--config-dir", "own", "terrain=step", *teacher, *words, cwd=tmp_path)
        assert done.code == 2, done.err
        assert text in done.err


def test_a_configuration_folder_leaves_the_checks_of_a_training(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    words = ["terrain=flat", "conditions=varied", "sim.friction=0.5"]
    done = call("train", "--config-dir", "own", *words, cwd=tmp_path)
    assert done.code == 2, done.err
    assert "sim.friction=0.5: it has no effect, since randomise.friction=" in done.err


def test_python_takes_a_name_and_terms() -> None:
    loaded = flipperctl.load("mpc", rewards="smooth")
    assert (loaded.source.settings or {})["rewards"] == preset("smooth")
    with pytest.raises(ConfigError, match=r"controller.rewards: .*'smoth'"):
        flipperctl.load("mpc", rewards="smoth")
