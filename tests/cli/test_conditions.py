"""``conditions=…``: the same for policies and rules, shown with every result."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from flipperctl.cli.hydra.compose import compose_train
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.scenes import scenes
from flipperctl.env.flipper_env import FlipperEnv
from tests.cli.call import call
from tests.runtime import linear

GENERALIST = Path("generalist")
DRAWS = ["terrain=ramp", "--seed", "77", "--episodes", "2"]


@pytest.mark.parametrize("conditions", ["nominal", "varied"])
def test_equal_seeds_give_policies_and_rules_equal_draws(conditions: str, tmp_path: Path) -> None:
    documents, draws = [], []
    for folder, who in (("policy", "--checkpoint=generalist"), ("rule", "--controller=okada")):
        options = [f"conditions={conditions}", "--json", "--output", folder]
        done = call("eval", who, *DRAWS, *options, cwd=tmp_path)
        assert done.code == 0, done.err
        documents.append(json.loads(done.out)["scenes"][0])
        rows = list(csv.DictReader((tmp_path / folder / "episodes.csv").read_text().splitlines()))
        draws.append([[row[k] for k in ("seed", "start_shift", "start_front")] for row in rows])
        noted = {(row["conditions"], row["conditions_hash"]) for row in rows}
        assert noted == {(conditions, documents[-1]["conditions"]["hash"])}
    policy, rule = documents
    assert draws[0] == draws[1]
    assert policy["conditions"] == rule["conditions"]
    assert policy["seed"] == rule["seed"] == 77
    assert policy["conditions"]["name"] == conditions


def test_the_default_is_nominal_for_both() -> None:
    found = [scenes(["terrain=step"], *who)[0][0] for who in ((GENERALIST, None), (None, "okada"))]
    policy, rule = found
    assert policy.conditions == rule.conditions == "nominal"
    for section in ("terrain", "robot", "sim", "perception", "episode", "randomise"):
        assert getattr(policy, section) == getattr(rule, section)
    assert policy.rewards != rule.rewards  # a policy keeps those of its training


def test_wide_conditions_move_neither_ground_nor_start() -> None:
    found = scenes(["terrain=rubble", "conditions=nominal,wide"], Path("generalist"), None)
    nominal, wide = (config for config, _ in found)
    assert [config.conditions for config, _ in found] == ["nominal", "wide"]
    exact, drawn = FlipperEnv(config=nominal), FlipperEnv(config=wide)
    for seed in range(3):
        exact.reset(seed=seed)
        drawn.reset(seed=seed)
        assert np.array_equal(exact.profile.points, drawn.profile.points)
        # The same place of the unit interval: ± 0.05 m, and ± 0.1 m.
        shifts = (env._sampled_values["start_shift"] for env in (exact, drawn))
        one, two = shifts
        assert two == pytest.approx(2 * one)


def test_overrides_lie_over_the_conditions_and_one_without_effect_is_refused(
    tmp_path: Path,
) -> None:
    ((config, _),) = scenes(["conditions=varied", "sim.gravity=3.7"], None, "okada")
    assert (config.sim.gravity, config.episode.start_noise) == (3.7, 0.1)
    noise = ["eval", "--controller", "okada", "conditions=varied", "perception.noise=0.05"]
    done = call(*noise, cwd=tmp_path)
    assert done.code == 2
    assert "perception.noise=0.05: it has no effect, since randomise.noise=[0,0.01]" in done.err
    switch = ["eval", "--controller", "okada", "perception.occlusion=true"]
    done = call(*switch, "randomise.occlusion=0.5", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "it has no effect, since randomise.occlusion=0.5 samples it" in done.err
    ((config, _),) = scenes([*noise[3:], "randomise.noise=null"], None, "okada")
    assert (config.perception.noise, config.randomise.noise) == (0.05, None)
    ((config, _),) = scenes([*noise[3:], "randomise.spread=[0,1]"], None, "okada")
    assert config.perception.noise == 0.05  # samples lie around it


def test_a_training_refuses_an_override_without_effect_too(tmp_path: Path) -> None:
    robot = ["robot.chassis_mass=24", "randomise.chassis_mass=[21,27]"]
    (config,) = compose_train(Overrides.parse(robot))
    assert config.robot.chassis_mass == 24  # which the exported policy assumes
    words = ["train", "terrain=flat", "sim.friction=0.4", "randomise.friction=[0.9,1.2]"]
    done = call(*words, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "sim.friction=0.4: it has no effect, since randomise.friction=[0.9,1.2]" in done.err
    assert list(tmp_path.iterdir()) == []


def test_the_table_says_those_that_are_not_the_default_in_a_line(tmp_path: Path) -> None:
    both = ["conditions=nominal,varied", "terrain=flat", "--episodes", "1", "--output", "out"]
    done = call("eval", "--controller", "okada", "--baseline", "level", *both, cwd=tmp_path)
    assert done.code == 0, done.err
    scenes = json.loads((tmp_path / "out" / "summary.json").read_text())["scenes"]
    (line,) = (line for line in done.out.splitlines() if line.startswith("conditions "))
    assert line.startswith("conditions varied: randomised friction 0.8 to 1.2, ")
    for name in ("nominal", "varied"):
        assert re.search(rf"\nflat, {name} +okada ", done.out)  # the row that it is about
    hashes = [scene["conditions"]["hash"] for scene in scenes]
    pictures = {p.name for p in (tmp_path / "out").glob("*.png")}
    assert pictures == {f"flat_nominal_{hashes[0]}.png", f"flat_varied_{hashes[1]}.png"}


def test_the_audit_is_under_the_same_conditions(tmp_path: Path) -> None:
    options = ["--checkpoint", "generalist", "terrain=flat", "--episodes", "1", "--json"]
    found = [
        json.loads(call(*command, *options, cwd=tmp_path).out)
        for command in (["inspect", "reward"], ["eval"])
    ]
    assert found[0]["conditions"] == found[1]["scenes"][0]["conditions"]
    words = ["terrain=flat", "conditions=varied", "sim.friction=0.5", "randomise.friction=null"]
    done = call("inspect", "reward", *words, "--episodes", "1", cwd=tmp_path)
    assert done.out.splitlines()[-1].startswith("conditions varied: randomised chassis_mass 30 to ")
    assert "; physics friction 0.5" in done.out


def test_trained_needs_a_checkpoint(tmp_path: Path) -> None:
    scenes(["conditions=trained"], GENERALIST, None)  # Hydra now knows them
    for command in (["eval", "--controller", "okada"], ["inspect", "reward"]):
        done = call(*command, "conditions=trained", cwd=tmp_path)
        assert done.code == 2
        assert "need --checkpoint; known: nominal, paper, varied" in done.err
    linear.write(tmp_path / "p.onnx", terrain="flat", terrain_config={"name": "flat"})
    done = call("eval", "--checkpoint", "p.onnx", "conditions=trained", cwd=tmp_path)
    assert done.code == 2
    assert "an exported file does not hold those of its training" in done.err


@pytest.mark.parametrize(
    ("wrong", "words"),
    [("conditions=varid", "did you mean 'varied'?"), ("conditions=null", "null is not allowed")],
)
def test_others_are_refused(wrong: str, words: str, tmp_path: Path) -> None:
    for command in (["eval", "--controller", "okada"], ["train"]):
        done = call(*command, wrong, cwd=tmp_path)
        assert done.code == 2
        assert words in done.err
        assert done.err.count("\n") == 1


@pytest.mark.parametrize("command", [["reward"], ["config"], ["terrain", "step"]])
def test_a_command_that_looks_at_one_configuration_refuses_several(
    command: list[str], tmp_path: Path
) -> None:
    done = call("inspect", *command, "conditions=nominal,varied", cwd=tmp_path)
    assert done.code == 2
    assert "give 2 configurations; this command takes one configuration" in done.err


def test_a_policy_says_which_settings_of_its_training_it_is_evaluated_without(
    short_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes(["terrain=step"], short_run, None)
    assert capsys.readouterr().err == ""  # it was trained under nominal conditions
    scenes(["terrain=step,flat"], GENERALIST, None)
    line = capsys.readouterr().err
    assert line.count("\n") == 1  # once for both scenes
    assert "generalist: trained with episode.start_noise=0.1 (0.05)" in line
    assert "conditions=trained" in line
    for chosen in ("conditions=trained", "conditions=widest"):
        scenes(["terrain=step", chosen], GENERALIST, None)
        assert capsys.readouterr().err == ""
    scenes(["terrain=step", "episode.start_noise=0.1"], GENERALIST, None)
    assert "episode.start_noise" not in capsys.readouterr().err


def test_a_file_of_a_robot_may_have_settings_that_are_sampled(tmp_path: Path) -> None:
    file = tmp_path / "rover.yaml"
    file.write_text("chassis_mass: 24\n")
    words = [f"robot={file}", "randomise.chassis_mass=[21,27]"]
    ((config, _),) = scenes(words, None, "okada")
    (training,) = compose_train(Overrides.parse(words))
    assert config.robot.chassis_mass == training.robot.chassis_mass == 24
