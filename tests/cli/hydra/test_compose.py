"""Composition: sweeps are expanded as Hydra would, and a checkpoint's settings are the defaults."""

from typing import Any

import pytest

from flipperctl.api import Shaping
from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import EnvConfig, EvalConfig, Teacher, TrainConfig, to_dict, with_overrides
from flipperctl.errors import ConfigError
from flipperctl.lookahead.controllers import Mpc
from flipperctl.sim.planar import PlanarSensor

MPC = to_dict(Mpc(value=""))


def compose_train(words: list[str]) -> list[TrainConfig]:
    return compose.compose_train(Overrides.parse(words))


def compose_eval(
    words: list[str], primary: str = config_store.EVAL_CONTROLLER
) -> list[tuple[EvalConfig, dict[str, Any] | None]]:
    return compose.compose_eval(Overrides.parse(words), primary)


def compose_environment(words: list[str]) -> EnvConfig:
    return compose.compose_environment(Overrides.parse(words))


@pytest.fixture(autouse=True)
def defaults() -> None:
    config_store.register_defaults()


def test_every_combination_of_a_sweep_is_composed() -> None:
    found = compose_train(["seed=range(1,4)", "terrain=choice(step,stair)", "device=cpu"])
    assert [(c.seed, c.terrain.plugin_name) for c in found] == [
        (seed, terrain) for seed in (1, 2, 3) for terrain in ("step", "stair")
    ]


@pytest.mark.parametrize(
    "word", ["terrain=stair,step,stair", "seed=1,2,1", "sim.friction=1,0.5,1.0", "terrain='a','a'"]
)
def test_a_list_with_a_value_twice_is_refused(word: str) -> None:
    with pytest.raises(ConfigError, match="is given twice; once is allowed"):
        list(Overrides.parse([word]).combinations())


def test_an_interval_is_the_sweepers_business() -> None:
    (config,) = compose_train(["agent.gamma=interval(0.9,0.95)"])
    assert config.agent.gamma == 0.99  # the default: no value was drawn


def test_a_checkpoint_brings_its_terrain_robot_and_layout_to_its_evaluation() -> None:
    base = TrainConfig(terrain="stair", network="at_d3qn")
    changes = {
        "terrain.fewest": 2,
        "robot.chassis_mass": 60,
        "perception.bins": 21,
        "perception.noise": 0.02,
        "sim.friction": 0.8,
        "episode.start_noise": 0.2,
        "randomise.delay": [0.0, 0.1],
        "randomise.sim.gravity": [9.0, 10.0],
        "eval.episodes": 7,
    }
    trained = with_overrides(base, changes)
    primary = config_store.register_trained(trained)
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
    assert other.randomise.names == ["delay", "sim.friction", "sim.gravity", "robot.track_speed"]
    with pytest.raises(ConfigError, match=r"^sim\.friction=0\.7: it has no effect"):
        compose_eval([*changed, "sim.friction=0.7"], primary)
    changed = ["terrain=paper_stair", "conditions=trained", "sim.friction=0.9"]
    ((other, _),) = compose_eval(changed, primary)
    assert other.terrain.plugin_name == "paper_stair"
    assert (other.sim.friction, other.perception.noise, other.eval.episodes) == (0.9, 0.02, 7)


@pytest.mark.parametrize("word", ["sim={friction:0.7}", "sim={friction:0.7,gravity:9}"])
def test_a_mapping_of_sampled_settings_has_no_effect(word: str) -> None:
    with pytest.raises(ConfigError, match=r"^sim=\{friction:0\.7.*: it has no effect"):
        compose_train(["terrain=flat", "conditions=varied", word])


def test_the_experiment_wide_stair_takes_in_the_papers_scene() -> None:
    (config,) = compose_train(["experiment=wide_stair"])
    terrain = config.terrain.model_dump()
    assert terrain["most"] == 6
    assert terrain["tread_down"] - terrain["tread_spread"] == pytest.approx(0.2)


# Teachers


def test_several_loggers_and_their_settings_are_chosen_by_name() -> None:
    chosen = {
        "": ["tensorboard"],
        "logger=csv": [],
        "logger=[]": [],
        "~logger": [],
        "logger=[tensorboard,wandb]": ["tensorboard", "wandb"],
        "+logger@logger.second=wandb": ["tensorboard", "second"],
    }
    for override, names in chosen.items():
        (config,) = compose_train([override] if override else [])
        assert list(config.logger) == names
    (config,) = compose_train(["logger=wandb", "logger.wandb.project=stairs"])
    assert to_dict(config)["logger"]["wandb"]["project"] == "stairs"


def test_there_is_a_teacher_only_on_request() -> None:
    paper, quick = (
        compose_train(words)[0].teacher for words in (["terrain=stair"], ["experiment=quick"])
    )
    assert paper == quick == Teacher()
    assert paper.controller is None


def test_a_teacher_and_its_settings_are_chosen_by_name() -> None:
    (config,) = compose_train(["teacher=mpc", "teacher.controller.beam=5", "teacher.td_weight=0"])
    assert to_dict(config.teacher.controller) == {**MPC, "beam": 5}
    assert config.teacher.td_weight == 0
    (config,) = compose_train(["experiment=taught", "terrain=ramp"])
    assert to_dict(config.teacher.controller)["name"] == "mpc"
    assert config.terrain.plugin_name == "ramp"
    assert config.rewards == EnvConfig(terrain="ramp").rewards


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


# Presets of rewards


def test_the_default_is_the_papers_rewards_everywhere() -> None:
    paper = EnvConfig(terrain="stair").rewards
    (named,) = compose_train(["rewards=paper"])
    (train,) = compose_train([])
    assert named.rewards == train.rewards == compose_environment([]).rewards == paper


def test_presets_beside_the_papers_count_swing_at_100_hz() -> None:
    paper, tuned, smooth = compose_train(["rewards=paper,tuned,smooth"])
    assert paper.rewards.keys() - tuned.rewards.keys() == {"pitch"}
    for preset in (tuned, smooth):
        assert {"swing", "end", "shaped_progress"} < preset.rewards.keys() - {"pitch"}
    assert compose_environment(["rewards=tuned"]).rewards == tuned.rewards


@pytest.mark.parametrize(
    ("preset", "term", "field"), [("paper", "pitch", "lambda_2"), ("tuned", "swing", "slope")]
)
def test_a_presets_terms_are_changed_added_and_dropped(preset: str, term: str, field: str) -> None:
    changes = [f"rewards.{term}.{field}=5", "~rewards.flipper", "+reward@rewards.hit=impact"]
    other = "reward@rewards.end=progress"
    (plain,) = compose_train([f"rewards={preset}"])
    (config,) = compose_train([f"rewards={preset}", *changes, other])
    assert set(config.rewards) == set(plain.rewards) - {"flipper"} | {"hit"}
    assert config.rewards[term].model_dump()[field] == 5
    assert config.rewards["end"].plugin_name == "progress"


def test_the_tuned_shaping_follows_the_agents_discount() -> None:
    for config in compose_train(["rewards=tuned", "agent.gamma=0.9,0.95"]):
        (shaping,) = (term for term in config.rewards.values() if isinstance(term, Shaping))
        assert shaping.gamma == config.agent.gamma


def test_a_checkpoint_is_judged_by_its_own_rewards_or_by_a_preset() -> None:
    (trained,) = compose_train(["rewards=tuned", "rewards.swing.slope=5"])
    primary = config_store.register_trained(trained)
    ((own, _),) = compose_eval([], primary)
    assert own.rewards == trained.rewards
    ((changed, _),) = compose_eval(["rewards.swing.weight=4"], primary)
    assert changed.rewards["swing"] == trained.rewards["swing"].model_copy(update={"weight": 4})
    ((preset, _),) = compose_eval(["rewards=paper"], primary)
    assert preset.rewards == EnvConfig(terrain="stair").rewards
