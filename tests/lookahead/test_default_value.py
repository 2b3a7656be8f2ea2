"""The value of ``mpc`` that null stands for, and the robots for which it is not used."""

import re
from pathlib import Path
from typing import Any

import pytest

import flipperctl
from flipperctl.config import EnvConfig, resolver, to_dict, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation import plan
from flipperctl.lookahead import Mpc, Planner, planner
from flipperctl.lookahead.mpc import MpcPolicy, ReturnPolicy
from flipperctl.lookahead.settings import HAND_SET
from flipperctl.policies.source import PolicySource, learned_value, with_files
from flipperctl.requests import compose
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from tests.short import short_config, trainer

FLAT = EnvConfig(terrain="flat")
SMALLER = {"robot.flipper_length": 0.45}
NOTE = r"controller\.value: mpc_value was not trained for robot\.flipper_length=0\.45 \(0\.5253 to"


def built(settings: Any, config: EnvConfig = FLAT) -> type[object]:
    """Return the class of the policy that a controller builds with its files."""
    found = resolver.create("controller", settings, "controller")
    return type(with_files(found, config).build())


def composed(*words: str) -> dict[str, Any]:
    ((_, settings),) = compose.compose_eval(from_words(["controller=mpc", *words]))
    return settings


def taught(*words: str) -> dict[str, Any]:
    (config,) = compose.compose_train(from_words(list(words)))
    return to_dict(config)["teacher"]["controller"]


def test_null_is_the_shipped_value_and_saved_settings_name_it() -> None:
    saved = to_dict(Mpc())
    assert (saved["value"], saved["fallback"]) == ("mpc_value", True)
    assert resolver.create("controller", saved, "controller") == Mpc()
    assert composed()["value"] is None  # so that other settings can still choose
    assert built(composed()) is built("mpc") is ReturnPolicy
    assert built({"name": "mpc", "value": ""}) is MpcPolicy
    assert learned_value("mpc_value", "here") is learned_value("mpc_value", "here")  # read once


def test_a_setting_of_the_hand_set_cost_chooses_that_and_others_do_not() -> None:
    for name in HAND_SET:
        other = 1.5 * Mpc.model_fields[name].default
        assert (Mpc(**{name: other}).value, Mpc(**{name: other}).assumed_friction) == ("", 0.8)
        assert Mpc(**{name: other, "value": "mpc_value"}).value == "mpc_value"
    chosen = resolver.create("controller", composed("controller.swing=15"), "controller")
    assert chosen.value == ""
    for words in (["controller.beam=4"], ["controller.swing=10"], ["controller.memory=8"]):
        assert built(composed(*words)) is ReturnPolicy
    assert Mpc(beam=4, friction=0.7).value == "mpc_value"
    # Rewards alone take no other objective's value.
    assert Mpc(rewards={"end": "end"}).value == ""
    assert Mpc(rewards={"end": "end"}, value="mpc_value").value == "mpc_value"


def test_presets_teach_with_the_hand_set_cost_and_the_generalist_s_with_values() -> None:
    for word in ("teacher=mpc", "teacher=lookahead", "experiment=taught"):
        assert taught(word)["value"] == ""
    own = taught("teacher=mpc", "teacher.controller.value=null")
    assert (own["value"], own["fallback"]) == ("mpc_value", True)
    found = taught("experiment=generalist")
    assert (found["value"], bool(found["fallback"])) == ("mpc_value_large", False)


def test_a_name_beside_another_policy_is_the_hand_set_cost() -> None:
    (baseline,) = plan.controllers("mpc", "--baseline")
    compared = plan.policies(["level,mpc"], {}, print)["mpc"]
    valued = plan.policies(["level,mpc"], {"value": "mpc_value"}, print)["mpc"]
    assert baseline == compared
    assert built(baseline.settings) is MpcPolicy
    assert built(valued.settings) is ReturnPolicy
    assert type(planner.PlannerPolicy(Planner(), None)._starts["mpc"]) is MpcPolicy


# Other robots


@pytest.mark.parametrize(
    ("changed", "fits"),
    [
        ({}, True),
        ({"robot.flipper_length": 0.546}, True),  # 2 % more
        ({"robot.flipper_length": 0.548}, False),
        ({"robot.angle_limit": 1.2}, False),
        ({"robot.track_speed": 0.5, "robot.chassis_mass": 60.0}, True),
        ({"perception.bins": 7}, False),
        ({"perception.bins": 75, "perception.bin_width": 0.03}, True),  # as far, finer
    ],
)
def test_the_default_is_used_for_robots_like_those_of_its_training(
    changed: dict[str, float], fits: bool
) -> None:
    config = with_overrides(FLAT, changed)
    assert built("mpc", config) is (ReturnPolicy if fits else MpcPolicy)
    assert bool(list(PolicySource(settings={"name": "mpc"}).notes(config))) is not fits
    for named in ({"value": "mpc_value"}, {"fallback": False}):
        assert built({"name": "mpc", **named}, config) is ReturnPolicy
    named = {"value": "mpc_value", "fallback": True}
    assert built({"name": "mpc", **named}, config) is (ReturnPolicy if fits else MpcPolicy)


def test_the_range_of_a_training_s_robots_counts(tmp_path: Path) -> None:
    lengths = {"randomise.robot.flipper_length": [0.5, 0.6]}
    config = short_config(**{**lengths, "robot.angle_limit": 1.0})
    trainer(config, tmp_path).save()
    sizes = learned_value(str(tmp_path), "controller.value").sizes
    assert sizes["flipper_length"] == (0.5, 0.6)
    assert sizes["angle_limit"] == pytest.approx((0.98, 1.02))


def test_one_line_says_that_the_value_is_not_used(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = ["terrain=flat,step", "robot.flipper_length=0.45"]
    scenes(from_words(words), None, "mpc")
    env = FlipperEnv("flat", **SMALLER)
    env.reset(seed=1)
    loaded = flipperctl.load("mpc", beam=1, horizon=1)
    for _ in range(2):
        loaded.reset(env)
    run = trainer(short_config(**{"teacher.controller": "mpc", **SMALLER}), tmp_path)
    of_eval_and_python = " ".join(capsys.readouterr().err.split())
    (of_teacher,) = run._early_notes or ()
    assert len(re.findall(NOTE, of_eval_and_python)) == 2
    assert re.match(NOTE, of_teacher.removeprefix("teacher."))
    scenes(from_words([*words, "controller.value=mpc_value"]), None, "mpc")
    scenes(from_words(words), None, "okada")
    assert not capsys.readouterr().err
