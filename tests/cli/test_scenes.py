"""The scenes that ``conditions=…`` and ``suite=…`` choose, for policies and rules."""

import csv
import json
import re
from pathlib import Path

import pytest

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.config.presets import shipped
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.plan import NamedPolicy, Plan, find_suite
from flipperctl.requests.compose import compose_train
from flipperctl.requests.plan import make_plan, scenes
from flipperctl.requests.text import from_words
from tests.cli.call import call, refused

GENERALIST = Path("generalist")


def test_the_default_is_nominal_for_both() -> None:
    ((policy, _),) = scenes(from_words(["terrain=step"]), GENERALIST, None)
    layout = f"perception.highest={str(policy.perception.highest).lower()}"
    ((rule, _),) = scenes(from_words(["terrain=step", layout]), None, "okada")
    assert policy.conditions == rule.conditions == "nominal"
    for section in ("terrain", "robot", "sim", "perception", "episode", "randomise"):
        assert getattr(policy, section) == getattr(rule, section)
    assert policy.rewards != rule.rewards  # a policy keeps those of its training


def test_an_override_over_the_conditions_without_effect_is_refused(tmp_path: Path) -> None:
    ((config, _),) = scenes(from_words(["conditions=varied", "sim.gravity=3.7"]), None, "okada")
    assert (config.sim.gravity, config.episode.start_noise) == (3.7, 0.1)
    noise = ["conditions=varied", "perception.noise=0.05"]
    error = refused("eval", "okada", *noise, cwd=tmp_path)
    wanted = "perception.noise=0.05: it has no effect, since randomise.perception.noise=[0,0.01]"
    assert wanted in error
    ((config, _),) = scenes(from_words([*noise, "randomise.perception.noise=null"]), None, "okada")
    assert config.perception.noise == 0.05
    assert "noise" not in config.randomise.perception
    ((config, _),) = scenes(from_words([*noise, "randomise.spread=[0,1]"]), None, "okada")
    assert config.perception.noise == 0.05  # samples lie around it
    robot = ["robot.chassis_mass=24", "randomise.robot.chassis_mass=[21,27]"]
    (trained,) = compose_train(from_words(robot))
    assert trained.robot.chassis_mass == 24  # which the exported policy assumes
    words = ["train", "terrain=flat", "sim.friction=0.4", "randomise.sim.friction=[0.9,1.2]"]
    error = refused(*words, cwd=tmp_path)
    assert "sim.friction=0.4: it has no effect, since randomise.sim.friction=[0.9,1.2]" in error


def test_the_table_says_those_that_are_not_the_default_in_a_line(tmp_path: Path) -> None:
    both = ["conditions=nominal,varied", "terrain=flat", "--episodes", "1", "--output", "out"]
    done = call("eval", "--controller", "okada", "--baseline", "level", *both, cwd=tmp_path)
    assert done.code == 0, done.err
    scenes = json.loads((tmp_path / "out" / "summary.json").read_text())["scenes"]
    (line,) = (line for line in done.out.splitlines() if line.startswith("conditions "))
    assert line.startswith("conditions varied: randomised sim.friction 0.8 to 1.2, ")
    for name in ("nominal", "varied"):
        assert re.search(rf"\nflat, {name} +okada ", done.out)  # the row that it is about
    hashes = [scene["conditions"]["hash"] for scene in scenes]
    pictures = {p.name for p in (tmp_path / "out").glob("*.png")}
    assert pictures == {f"flat_nominal_{hashes[0]}.png", f"flat_varied_{hashes[1]}.png"}


def test_a_policy_says_which_settings_of_its_training_it_is_evaluated_without(
    short_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes(from_words(["terrain=step"]), short_run, None)
    assert capsys.readouterr().err == ""  # it was trained under nominal conditions
    scenes(from_words(["terrain=step,flat"]), GENERALIST, None)
    line = capsys.readouterr().err
    assert line.count("\n") == 1  # once for both scenes
    assert (found := re.search(r"generalist: nominal.* others \((\d+) settings; cond", line))
    for chosen in ("conditions=trained", "conditions=widest"):
        scenes(from_words(["terrain=step", chosen]), GENERALIST, None)
        assert capsys.readouterr().err == ""
    scenes(from_words(["terrain=step", "episode.start_noise=0.1"]), GENERALIST, None)
    assert f"({int(found[1]) - 1} settings;" in capsys.readouterr().err  # one was chosen


def test_a_policy_tells_its_risk_of_all_scenes_in_one_line(tmp_path: Path) -> None:
    shown = call("eval", "generalist", "terrain=flat,ramp", "--episodes", "1", cwd=tmp_path)
    told = [line for line in shown.out.splitlines() if line.startswith("risk")]
    assert len(told) == 1
    assert "generalist: no failure to announce; false alarms in 0 of 2 successes" in told[0]


_GROUPS = "terrain", "sim", "perception", "conditions"


def composed(name: str, *words: str) -> Plan:
    return make_plan(from_words([f"suite={name}", *words]), [NamedPolicy("okada")], "level", print)


def test_each_scene_of_each_shipped_suite_is_a_configuration_of_its_own() -> None:
    """Without Hydra, which takes ten times as long."""
    names = (
        "families ftr generalist generalist_3d held_out numerics paper robustness sides strange "
        "torque"
    )
    assert list(shipped("suite")) == names.split()
    for name in shipped("suite"):
        hashes = []
        for scene in find_suite(name).scenes:
            for chosen in from_words(scene.words).combinations():
                groups = {key: chosen.choice(key) for key in _GROUPS}
                plain = {k: v for k, v in chosen.values().items() if k not in groups}
                named = {key: choice for key, choice in groups.items() if choice}
                found = with_overrides(EvalConfig(**named), plain)
                assert isinstance(found, EvalConfig)
                number = found.eval.episodes if name == "paper" else 0
                hashes.append((Conditions.of(found).hash, number, groups["conditions"]))
        assert len(set(hashes)) == len(hashes) >= 6, name


def test_methods_stand_scene_by_scene_and_overrides_replace_those_of_the_suite() -> None:
    plan = composed("families", "terrain=step,flat", "eval.episodes=3")
    assert plan.title == "suite families: okada"
    assert [entry.terrain for entry in plan.entries] == ["step", "step", "flat", "flat"]
    assert [entry.method for entry in plan.entries] == ["okada", "level"] * 2
    assert {entry.scene for entry in plan.entries} == {"families"}
    assert {entry.config.eval.episodes for entry in plan.entries} == {3}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("scene: {a: terrain=flat}", "about: TEXT and scenes"),
        ("scenes: {a: [terrain=flat]}", "scenes.a: about: TEXT"),
        ("scenes: {a: 'x", "line 1: no YAML"),
    ],
)
def test_a_file_that_is_no_suite_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=expected) as refused:
        find_suite(str(file))
    assert str(file) in str(refused.value)


def test_a_scene_whose_words_are_replaced_says_so() -> None:
    """Otherwise "100 repeats" has the two episodes that were asked for."""
    scenes = {entry.scene for entry in composed("paper", "terrain=flat").entries}
    assert "100 repeats" in scenes
    scenes = {entry.scene for entry in composed("paper", "eval.episodes=2").entries}
    assert {"5 repeats, eval.episodes=2", "100 repeats, eval.episodes=2"} <= scenes


def test_files_of_results_name_the_suites_scenes(tmp_path: Path) -> None:
    text = "scenes: {dry: terrain=flat sim.friction=1.2, wet: terrain=flat sim.friction=0.6}\n"
    (tmp_path / "mine.yaml").write_text(f"about: of two scenes\n{text}")
    words = ("suite=mine.yaml", "--baseline", "none", "--episodes", "1")
    done = call("eval", "okada", *words, "--output", "judged", cwd=tmp_path)
    assert done.code == 0, done.err
    for name in ("episodes.csv", "table.csv"):
        rows = csv.DictReader((tmp_path / "judged" / name).read_text().splitlines())
        assert [row["suite_scene"] for row in rows] == ["dry", "wet"]
    latex = (tmp_path / "judged" / "table.tex").read_text()
    assert "flat, dry &" in latex
    assert "flat, wet &" in latex


def test_hashes_lack_the_defaults_of_settings_that_were_added_later() -> None:
    plain = with_overrides(EvalConfig(terrain="step", sim="mujoco"), {})
    assert isinstance(plain, EvalConfig)
    assert not {"stagger", "oblique", "mirrored"} & Conditions.of(plain).settings["sim"].keys()
    sampled = with_overrides(plain, {"sim.oblique": 0.2, "randomise.sim.mirrored": 0.5})
    assert isinstance(sampled, EvalConfig)
    settings = Conditions.of(sampled).settings
    assert settings["sim"].keys() & {"stagger", "oblique", "mirrored"} == {"oblique"}
    assert settings["randomise"]["sim"] == {"mirrored": 0.5}
