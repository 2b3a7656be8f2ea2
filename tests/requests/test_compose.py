"""Composition: sweeps are expanded as Hydra would, presets are taken, a checkpoint has defaults."""

from pathlib import Path
from typing import Any

import pytest

from flipperctl.cli.reward import controller_fields
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig, to_dict, with_overrides
from flipperctl.errors import ConfigError
from flipperctl.evaluation.plan import policies
from flipperctl.learners import D3qn
from flipperctl.lookahead import Mpc
from flipperctl.requests import compose
from flipperctl.requests.request import Requests
from flipperctl.requests.text import from_words
from flipperctl.sim.planar import PlanarSensor
from tests.cli.call import EXACT, call

MPC = to_dict(Mpc(value=""))


def compose_train(words: list[str]) -> list[TrainConfig]:
    return compose.compose_train(from_words(words))


def compose_eval(
    words: list[str], primary: str = compose.EVAL_CONTROLLER
) -> list[tuple[EvalConfig, dict[str, Any] | None]]:
    return compose.compose_eval(from_words(words), primary)


@pytest.fixture(autouse=True)
def defaults() -> None:
    compose.register_defaults()


def test_a_checkpoint_brings_its_terrain_robot_and_layout_to_its_evaluation() -> None:
    base = TrainConfig(terrain="stair", network="at_d3qn")
    changes = {
        "terrain.steps": [2, 6],
        "robot.chassis_mass": 60,
        "perception.bins": 21,
        "perception.noise": 0.02,
        "sim.friction": 0.8,
        "episode.start_noise": 0.2,
        "randomise.perception.delay": [0.0, 0.1],
        "randomise.sim.gravity": [9.0, 10.0],
        "eval.episodes": 7,
    }
    trained = with_overrides(base, changes)
    primary = compose.register_trained(trained)
    ((nominal, controller),) = compose_eval([], primary)
    assert controller is None
    assert nominal.conditions == "nominal"
    assert (nominal.terrain, nominal.robot) == (trained.terrain, trained.robot)
    assert nominal.perception == PlanarSensor(bins=21)
    defaults = EnvConfig(terrain="stair")
    assert (nominal.sim, nominal.episode) == (defaults.sim, defaults.episode)
    assert (nominal.randomise, nominal.eval.episodes) == (defaults.randomise, 7)

    ((same, _),) = compose_eval(["conditions=trained"], primary)
    assert same.conditions == "trained"
    assert same.environment() == trained.environment()
    # Paths need no +, whether or not the training has one in that section.
    paths = ["randomise.sim.friction=[0.8,0.9]", "randomise.robot.track_speed=0.2"]
    changed = ["terrain=paper_stair", "conditions=trained", *paths]
    ((other, _),) = compose_eval(changed, primary)
    assert other.randomise.names == [
        *("sim.friction", "robot.track_speed", "perception.delay", "sim.gravity")
    ]
    with pytest.raises(ConfigError, match=r"^sim\.friction=0\.7: it has no effect"):
        compose_eval([*changed, "sim.friction=0.7"], primary)
    changed = ["terrain=paper_stair", "conditions=trained", "sim.friction=0.9"]
    ((other, _),) = compose_eval(changed, primary)
    assert other.terrain.plugin_name == "paper_stair"
    assert (other.sim.friction, other.perception.noise, other.eval.episodes) == (0.9, 0.02, 7)


def test_the_taught_experiment_takes_any_teacher() -> None:
    (own,) = compose_train(["experiment=taught"])
    assert to_dict(own.teacher.controller) == {**MPC, "beam": 4, "horizon": 8, "of_each": 1}
    for name in ("okada", "mpc", "none"):
        (config,) = compose_train(["experiment=taught", f"teacher={name}"])
        (alone,) = compose_train([f"teacher={name}"])
        assert config.teacher == alone.teacher  # nothing of the experiment's own teacher stays
        assert config.agent == own.agent
    (config,) = compose_train(["experiment=taught", "teacher.controller.beam=6"])
    assert to_dict(config.teacher.controller) == {**MPC, "beam": 6, "horizon": 8, "of_each": 1}


def test_the_papers_method_is_an_experiment_and_its_rewards_judge() -> None:
    paper = EnvConfig(terrain="stair").rewards
    (train,), (plain,) = compose_train(["experiment=paper"]), compose_train([])
    assert train.rewards == compose.compose_environment(Requests()).rewards == paper
    assert (train.perception.layout.size, plain.perception.layout.size) == (18, 33)
    assert train.agent == D3qn() != plain.agent


def test_a_presets_terms_are_changed_added_and_dropped() -> None:
    changes = ["rewards.swing.slope=5", "~rewards.flipper", "+reward@rewards.hit=impact"]
    other = "reward@rewards.end=progress"
    (plain,) = compose_train(["rewards=tuned"])
    (config,) = compose_train(["rewards=tuned", *changes, other])
    assert set(config.rewards) == set(plain.rewards) - {"flipper"} | {"hit"}
    assert config.rewards["swing"].model_dump()["slope"] == 5
    assert config.rewards["end"].plugin_name == "progress"


def test_a_checkpoint_is_judged_by_its_own_rewards_or_by_a_preset() -> None:
    (trained,) = compose_train(["rewards=tuned", "rewards.swing.slope=5"])
    primary = compose.register_trained(trained)
    ((own, _),) = compose_eval([], primary)
    assert own.rewards == trained.rewards
    ((changed, _),) = compose_eval(["rewards.swing.weight=4"], primary)
    assert changed.rewards["swing"] == trained.rewards["swing"].model_copy(update={"weight": 4})
    ((preset, _),) = compose_eval(["rewards=paper"], primary)
    assert preset.rewards == EnvConfig(terrain="stair").rewards


def controller_of(*words: str) -> dict[str, Any]:
    ((_, settings),) = compose.compose_eval(from_words(["controller=mpc", *words]))
    assert settings is not None
    return settings


def preset(name: str) -> dict[str, Any]:
    config = compose.compose_environment(from_words([f"rewards={name}"]))
    return {term: to_dict(settings) for term, settings in config.rewards.items()}


def test_the_preset_is_that_of_the_environment() -> None:
    own = compose.with_preset({"name": "mpc", "rewards": "tuned"}, "controller")
    assert own["rewards"] == preset("tuned")
    words = ("controller.rewards=tuned", "rewards=paper")
    assert controller_of(*words)["rewards"] == preset("tuned")


def test_a_teacher_has_presets_with_the_discount_of_the_training() -> None:
    words = ["teacher=mpc", "teacher.controller.rewards=smooth", "agent.gamma=0.9"]
    (config,) = compose.compose_train(from_words(words))
    controller = to_dict(config)["teacher"]["controller"]
    assert controller["rewards"]["shaped_progress"]["gamma"] == 0.9
    assert list(controller["rewards"]) == list(preset("smooth"))


def test_compared_controllers_with_that_field_have_the_preset() -> None:
    words = from_words(["controller.rewards=tuned", "terrain=step"])
    fields, others = controller_fields(words)
    sources = policies(["level,mpc"], fields, print)
    assert (sources["mpc"].settings or {})["rewards"] == preset("tuned")
    assert "rewards" not in (sources["level"].settings or {})
    assert others.words == ["terrain=step"]
    with pytest.raises(ConfigError, match=r"controller.rewards: .*'tune' .did you mean 'tuned'"):
        controller_fields(from_words(["controller.rewards=tune"]))


def test_a_preset_of_a_configuration_folder_counts_in_a_training(tmp_path: Path) -> None:
    """The terms are found; then ``mpc`` refuses to be paid by them without a value."""
    own = tmp_path / "own" / "rewards"
    own.mkdir(parents=True)
    (own / "mine.yaml").write_text("defaults:\n  - /reward@swing: swing\n")
    words = [f"{key}={value}" for key, value in EXACT.items()]
    for name, text in (("mine", "set controller.value"), ("mime", "'mime' (did you mean 'mine'")):
        teacher = ["teacher=mpc", f"teacher.controller.rewards={name}"]
        done = call("train", "--config-dir", "own", "terrain=step", *teacher, *words, cwd=tmp_path)
        assert done.code == 2, done.err
        assert text in done.err


def test_a_configuration_folder_leaves_the_checks_of_a_training(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    words = ["terrain=flat", "conditions=varied", "sim.friction=0.5"]
    done = call("train", "--config-dir", "own", *words, cwd=tmp_path)
    assert done.code == 2, done.err
    assert "sim.friction=0.5: it has no effect, since randomise.sim.friction=" in done.err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", compose.group_names("experiment"))
def test_an_experiment_takes_another_terrain(name: str) -> None:
    (config,) = compose_train([f"experiment={name}", "terrain=uplift"])
    assert config.terrain.plugin_name == "uplift"


def test_settings_of_an_experiment_for_another_plugin_are_left_out(
    capsys: pytest.CaptureFixture[str],
) -> None:
    (config,) = compose_train(["experiment=refined", "agent=d3qn"])
    assert config.agent.plugin_name == "d3qn"
    assert "agent=d3qn has not, left out: agent.anchor" in capsys.readouterr().err
    # Of a list, several plugins have settings.
    assert compose_train(["experiment=refined", "logger=tensorboard"])[0].logger
    # What is typed is refused as ever.
    with pytest.raises(ConfigError, match=r"agent\.anchor: there is no such key"):
        compose_train(["experiment=refined", "agent=d3qn", "agent.anchor=0.1"])
