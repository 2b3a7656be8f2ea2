"""``transfer`` and ``inspect engines``: two engines on the same episodes."""

import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flipperctl.terminal.transfer import _of_one
from tests.cli.call import call

OKADA = ["transfer", "--controller", "okada"]
HIGH = ["terrain=step", "terrain.low=0.4", "terrain.high=0.4"]


def scene(*arguments: str, cwd: Path) -> dict[str, Any]:
    done = call(*OKADA, *arguments, "--json", cwd=cwd)
    assert done.code == 0, done.err
    (found,) = json.loads(done.out)["scenes"]
    assert isinstance(found, dict)
    return found


def test_the_gap_is_paired_and_stands_beside_both_summaries(tmp_path: Path) -> None:
    found = scene("terrain=step", "--episodes", "3", "--output", "out", cwd=tmp_path)
    assert found["engines"] == ["planar", "mujoco"]
    assert found["planar"]["success_rate"] == found["mujoco"]["success_rate"] == 1.0
    # Three equal pairs prove no equality: |Δ| ≤ z² / (3 + z²) = 0.5615.
    assert found["success_gap"] == found["gap"]["success"] == {
        "mean": 0.0, "low": pytest.approx(-0.5615, abs=1e-4),
        "high": pytest.approx(0.5615, abs=1e-4),
        "episodes": 3, "won": 0, "lost": 0, "p": 1.0, "p_holm": 1.0,
    }  # fmt: skip
    assert (found["kept"], found["failures"], found["causes"]) == (1.0, [], {})
    gap = found["gap"]["t_cost"]
    assert gap["episodes"] == 3
    means = [found[engine]["t_cost"]["mean"] for engine in ("mujoco", "planar")]
    assert gap["mean"] == pytest.approx(means[0] - means[1])
    (written,) = json.loads((tmp_path / "out" / "transfer.json").read_text())["scenes"]
    assert written == found


# The belt climbs 0.4 m with a friction of 1, and not with 0.6.
@pytest.mark.parametrize(
    ("settings", "outcome", "cause"),
    [
        ([*HIGH, "sim.friction=0.6"], "stuck", "traction"),
        ([*HIGH, "sim.friction=0.15"], "stuck", "stuck"),
        (["terrain=flat", "sim.lateral_slope=0.2", "sim.roll_limit=0.1"], "overturned", "roll"),
        (["terrain=flat", "terrain.length=4", "sim.offset=1", "sim.heading_gain=0",
          "sim.lateral_slope=0.5", "sim.friction=0.5"], "overturned", "heading"),
        (["terrain=step", "episode.overturn=0.1"], "overturned", "overturned"),
    ],
    ids=["traction", "stuck", "roll", "heading", "overturned"],
)  # fmt: skip
def test_a_failure_has_its_cause(
    settings: list[str], outcome: str, cause: str, tmp_path: Path
) -> None:
    found = scene(*settings, "--only", "1", cwd=tmp_path)
    (failure,) = found["failures"]
    assert (failure["outcome"], failure["cause"]) == (outcome, cause)
    assert failure["episode"] == 1
    assert found["causes"] == {cause: 1}


def test_a_failure_has_the_command_that_shows_it_again(tmp_path: Path) -> None:
    settings = [*HIGH, "sim.friction=0.6", "--episodes", "2", "--seed", "5"]
    done = call(*OKADA, *settings, cwd=tmp_path)
    assert done.code == 0, done.err
    first = re.search(r"step, episode 1: .*", done.out)
    again = re.search(r"  flipperctl (.* --only 1)", done.out)
    assert first is not None
    assert again is not None
    repeated = call(*shlex.split(again.group(1)), cwd=tmp_path)
    assert first.group() in repeated.out
    done = call(*OKADA, *settings[:-2], "eval.seed=5", cwd=tmp_path)
    assert again.group() in done.out  # and eval.seed no second time


def test_the_words_of_one_result_are_those_of_the_call_without_its_lists() -> None:
    one = SimpleNamespace(terrain="step", conditions=SimpleNamespace(name="wide"))
    given = ["terrain=step,stair", "conditions=wide,nominal", "sim.yaw=0.1", "eval.seed=5"]
    assert list(_of_one(one, given)) == ["terrain=step", "conditions=wide", "sim.yaw=0.1"]
    own = ["terrain={name: ramp, slope_low: 15}", "conditions=wide"]
    assert list(_of_one(one, own)) == own
    assert list(_of_one(one, ["sim.friction=0.6"])) == ["sim.friction=0.6"]  # its own terrain


def test_the_default_engine_is_not_compared_with_itself(tmp_path: Path) -> None:
    for command in (OKADA, ["inspect", "engines"]):
        done = call(*command, "sim=planar", cwd=tmp_path)
        assert done.code == 2
        assert "choose another one, such as sim=mujoco" in done.err


def test_inspect_engines_lists_what_disagrees(tmp_path: Path) -> None:
    done = call("inspect", "engines", "terrain=ramp", "--episodes", "1", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "1/1" in done.out
    # A robot that drives across the ramp at an angle pitches less.
    slope = ["terrain=ramp", "sim.yaw=0.7", "sim.heading_gain=0", "--episodes", "1"]
    other = call("inspect", "engines", *slope, cwd=tmp_path)
    assert re.search(r"ramp, episode 0 \(seed \d+\): reached .*; they diverge at", other.out)
    document = json.loads(call("inspect", "engines", *slope, "--json", cwd=tmp_path).out)
    assert document["scenes"][0]["episodes"][0]["agrees"] is False
