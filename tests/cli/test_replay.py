"""``flipperctl replay``, and its pictures."""

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from flipperctl.api import Robot
from tests.cli.call import call, refused

LEVEL = ("eval", "level", "terrain=step", "terrain.low=0.4", "terrain.high=0.4", "--episodes", "1")
RECORD = "found/failure_step_0.json"


def test_a_failure_is_recorded_and_played_again_with_pictures_of_its_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot is sampled; a nominal one would hover above the ground or lie in it."""
    drawn = []

    def figure(
        states: object, profile: object, robot: Robot, *rest: object, **more: object
    ) -> Figure:
        drawn.append(robot.track_radius)
        return Figure()

    for module in ("flipperctl.evaluation.pictures", "flipperctl.figures.episode"):
        monkeypatch.setattr(f"{module}.episode_figure", figure)
    size = "randomise.robot.size=[0.8,0.8]"
    done = call(*LEVEL, size, "--output", "found", cwd=tmp_path)
    assert done.code == 0
    assert f"recorded a failure; to play the first again: flipperctl replay {RECORD}" in done.err
    done = call("replay", RECORD, "--output", "again", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "bit-identical to the recorded episode" in done.out
    assert drawn == pytest.approx([0.8 * Robot().track_radius] * 2)
    assert (tmp_path / "again/replay.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "again/replay.json").read_text())["identical"] is True

    record = json.loads((tmp_path / RECORD).read_text())
    (tmp_path / "wrong.json").write_text(json.dumps(record | {"digest": "0"}))
    done = call("replay", "wrong.json", cwd=tmp_path)
    assert done.code == 1
    assert "wrong.json: the episode differs from the recorded one: digest" in done.err


def test_settings_of_a_replay_are_those_of_the_record(tmp_path: Path) -> None:
    assert "sim.friction=2" in refused("replay", "failure.json", "sim.friction=2", cwd=tmp_path)
