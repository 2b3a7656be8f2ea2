"""``conditions=…``: the same for policies and rules, shown with every result."""

import json
import re
from pathlib import Path

import pytest

from flipperctl.cli.hydra.compose import compose_train
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.plan import scenes
from tests.cli.call import call, refused

GENERALIST = Path("generalist")


def test_the_default_is_nominal_for_both() -> None:
    found = [scenes(["terrain=step"], *who)[0][0] for who in ((GENERALIST, None), (None, "okada"))]
    policy, rule = found
    assert policy.conditions == rule.conditions == "nominal"
    for section in ("terrain", "robot", "sim", "perception", "episode", "randomise"):
        assert getattr(policy, section) == getattr(rule, section)
    assert policy.rewards != rule.rewards  # a policy keeps those of its training


def test_an_override_over_the_conditions_without_effect_is_refused(tmp_path: Path) -> None:
    ((config, _),) = scenes(["conditions=varied", "sim.gravity=3.7"], None, "okada")
    assert (config.sim.gravity, config.episode.start_noise) == (3.7, 0.1)
    noise = ["conditions=varied", "perception.noise=0.05"]
    error = refused("eval", "okada", *noise, cwd=tmp_path)
    assert "perception.noise=0.05: it has no effect, since randomise.noise=[0,0.01]" in error
    ((config, _),) = scenes([*noise, "randomise.noise=null"], None, "okada")
    assert (config.perception.noise, config.randomise.noise) == (0.05, None)
    ((config, _),) = scenes([*noise, "randomise.spread=[0,1]"], None, "okada")
    assert config.perception.noise == 0.05  # samples lie around it
    robot = ["robot.chassis_mass=24", "randomise.chassis_mass=[21,27]"]
    (trained,) = compose_train(Overrides.parse(robot))
    assert trained.robot.chassis_mass == 24  # which the exported policy assumes
    words = ["train", "terrain=flat", "sim.friction=0.4", "randomise.friction=[0.9,1.2]"]
    error = refused(*words, cwd=tmp_path)
    assert "sim.friction=0.4: it has no effect, since randomise.friction=[0.9,1.2]" in error


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
