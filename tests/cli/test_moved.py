"""Whoever types a command or an option of an earlier version is told what to type now."""

from pathlib import Path

import pytest

from tests.cli.call import refused

ENGINES = "is now: flipperctl eval POLICY sim=planar,mujoco\n"
GONE = "is gone; flipperctl compare DIR... gives the 95 % interval of each difference\n"


@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("transfer --controller okada terrain=step --only 1", f"transfer {ENGINES}"),
        ("inspect engines terrain=ramp", f"inspect engines {ENGINES}"),
        (
            "inspect conventions sim=mujoco",
            "is now: flipperctl inspect plugins --check, ",
        ),
        ("convert bag --output g.xyz", "flipperctl robot ground BAG --output FILE.xyz\n"),
        ("shadow p.onnx bag", "shadow is now: flipperctl robot shadow POLICY BAG\n"),
        ("inspect perception bag --at 3", "perception is now: flipperctl robot check BAG\n"),
        ("inspect results judged --json", "results is now: flipperctl compare DIR...\n"),
        ("eval --controller okada --map seed,agent.gamma", "flipperctl map POLICY --over SETTINGS"),
        ("eval --replay=failure_stair_3.json", "--replay is now: flipperctl replay FILE\n"),
        ("eval okada --detect 0.1", f"eval --detect {GONE}"),
        ("eval okada eval.static_bound=true", "eval.static_bound is gone; leave it out\n"),
        ("train terrain=ramp experiment=taught_margin", "experiment=taught teacher.loss=margin\n"),
        ("train experiment=generalist_first", "is now: experiment=generalist\n"),
        ("eval generalist_first", "generalist_first is gone; flipperctl eval generalist\n"),
        ("inspect checkpoint generalist_first", "did you mean 'generalist'?"),
        ("compare judged --detect-success 0.1", f"compare --detect-success {GONE}"),
    ],
)
def test_what_has_moved_is_named(typed: str, answer: str, tmp_path: Path) -> None:
    error = refused(*typed.split(), cwd=tmp_path)
    assert answer in error
    assert error.count("\n") == 1
