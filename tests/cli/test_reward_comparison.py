"""``inspect reward --compare``: policies ranked by return and by θ̂_R on the same draws."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.cli.call import call


def compare(names: str, *arguments: str, cwd: Path, episodes: int = 5) -> list[dict[str, Any]]:
    options = ["--compare", names, "--episodes", str(episodes), "--json"]
    done = call("inspect", "reward", *options, *arguments, cwd=cwd)
    assert done.code == 0, done.err
    scenes = json.loads(done.out)["scenes"]
    assert isinstance(scenes, list)
    return scenes


def verdicts(scene: dict[str, Any]) -> dict[str, str]:
    return {ranking["rewards"]: ranking["verdict"] for ranking in scene["rankings"]}


def test_the_presets_pay_the_smooth_way_and_a_price_of_turning_does_not(tmp_path: Path) -> None:
    # Over a ramp mpc swings less than the rule and turns the flippers for it.
    small = ["controller.beam=4", "controller.horizon=6"]
    ramp = ["terrain=ramp", "terrain.slope_low=20", "terrain.slope_high=25"]
    sets = ["rewards=tuned,smooth", "rewards.travel.weight=0.02,0.8"]
    (scene,) = compare("okada,mpc", *ramp, *sets, *small, cwd=tmp_path)
    assert scene["by_pitch_variation_100hz"] == ["mpc", "okada"]
    assert (scene["episodes"], scene["common"]) == (5, 5)
    assert verdicts(scene) == {
        "tuned rewards.travel.weight=0.02": "agrees",
        "smooth rewards.travel.weight=0.02": "agrees",
        "tuned rewards.travel.weight=0.8": "contradicts",
        "smooth rewards.travel.weight=0.8": "contradicts",
    }
    (found,) = next(
        r["contradictions"]
        for r in scene["rankings"]
        if "smooth" in r["rewards"] and r["contradictions"]
    )
    assert (found["paid"], found["calm"]) == ("okada", "mpc")
    assert next(iter(found["terms"])) == "travel"


def test_several_scenes_are_ranked_and_the_presets_agree_on_them(tmp_path: Path) -> None:
    sets = ["rewards=paper,tuned,smooth", "eval.seed=5"]
    scenes = compare("level,okada,generalist", "terrain=step,uplift", *sets, cwd=tmp_path)
    assert [scene["terrain"] for scene in scenes] == ["step", "uplift"]
    for scene in scenes:
        found = verdicts(scene)
        assert (found["tuned"], found["smooth"]) == ("agrees", "agrees")
        assert found.keys() == {"paper", "tuned", "smooth"}
        assert set(scene["policies"]) == {"level", "okada", "generalist"}
        for ranking in scene["rankings"]:
            means = [ranking["returns"][label]["mean"] for label in ranking["by_return"]]
            assert means == sorted(means, reverse=True)


def test_the_returns_are_those_of_an_evaluation_without_shaping(tmp_path: Path) -> None:
    options = ["terrain=step", "eval.seed=5"]
    (scene,) = compare("level,okada", *options, "rewards=paper", cwd=tmp_path)
    done = call("eval", "okada", "--episodes", "5", "--json", *options, cwd=tmp_path)
    (evaluated,) = json.loads(done.out)["scenes"]
    (ranking,) = scene["rankings"]
    assert ranking["returns"]["okada"]["mean"] == pytest.approx(evaluated["return"]["mean"])
    own = scene["policies"]["okada"]
    assert own["pitch_variation_100hz"]["mean"] == evaluated["pitch_variation_100hz"]["mean"]
    assert scene["conditions"] == evaluated["conditions"]


def test_the_table_names_draws_and_verdicts(tmp_path: Path) -> None:
    command = ["inspect", "reward", "--compare", "level,okada", "terrain=step", "--episodes", "2"]
    done = call(*command, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "2 of 2" in done.out
    assert "reward, paper" in done.out
    assert "paper: undecided (fewer than 5 common episodes) on step" in done.out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--compare", "level"], "at least two different names"),
        (["--compare", "level,level"], "at least two different names"),
        (["--compare", "level,okda"], "did you mean 'okada'"),
        (["--compare", "level,okada", "--controller", "okada"], "--compare names all policies"),
        (["--compare", "level,okada", "controller=level"], "--compare names the controllers"),
        (["--compare", "level,planner", "controller.widht=3"], "did you mean 'width'"),
        (["--compare", "level,okada", "~rewards"], "leaves no term"),
        (["--compare", "okada,generalist", "perception.bins=9"], "15 bins"),
    ],
)
def test_wrong_requests_are_refused(arguments: list[str], expected: str, tmp_path: Path) -> None:
    done = call("inspect", "reward", *arguments, cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    assert expected in done.err


def test_what_drives_for_a_reward_is_compared_by_one_alone(tmp_path: Path) -> None:
    words = ("--compare", "level,value_iteration", "terrain=step", "rewards=paper,smooth")
    done = call("inspect", "reward", *words, "--episodes", "1", cwd=tmp_path)
    assert done.code == 2
    assert "value_iteration drives otherwise for each of the rewards paper, smooth" in done.err
