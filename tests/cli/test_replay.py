"""``flipperctl eval --replay``, and its pictures."""

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from flipperctl.api import Robot
from tests.cli.call import call

LEVEL = ("eval", "--controller", "level", "terrain=step", "terrain.low=0.4", "terrain.high=0.4")


def test_a_failure_is_recorded_and_played_again(tmp_path: Path) -> None:
    done = call(*LEVEL, "--episodes", "1", "--output", "found", cwd=tmp_path)
    assert done.code == 0
    assert (
        "recorded a failure; to play the first again: flipperctl eval --replay found/fai"
        in done.err
    )
    file = "found/failure_step_0.json"
    done = call("eval", "--replay", file, "--output", "again", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "bit-identical to the recorded episode" in done.out
    assert (tmp_path / "again/replay.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "again/replay.json").read_text())["identical"] is True

    record = json.loads((tmp_path / file).read_text())
    (tmp_path / "wrong.json").write_text(json.dumps(record | {"digest": "0"}))
    done = call("eval", "--replay", "wrong.json", cwd=tmp_path)
    assert done.code == 1
    assert "wrong.json: the episode differs from the recorded one: digest" in done.err
    done = call("eval", "--replay", file, "sim.friction=2", cwd=tmp_path)
    assert done.code == 2
    assert "overrides: no meaning beside --replay" in done.err


def test_pictures_show_the_robot_that_drove(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is sampled; a nominal one would hover above the ground or lie in it."""
    drawn = []

    def figure(
        states: object, profile: object, robot: Robot, *rest: object, **more: object
    ) -> Figure:
        drawn.append(robot.track_radius)
        return Figure()

    for module in ("flipperctl.report.scenes", "flipperctl.report.episode"):
        monkeypatch.setattr(f"{module}.episode_figure", figure)
    words = (*LEVEL, "randomise.robot.size=[0.8,0.8]", "--episodes", "1", "--output", "found")
    assert call(*words, cwd=tmp_path).code == 0
    again = ("eval", "--replay", "found/failure_step_0.json", "--output", "again")
    assert call(*again, cwd=tmp_path).code == 0
    assert drawn == pytest.approx([0.8 * Robot().track_radius] * 2)
