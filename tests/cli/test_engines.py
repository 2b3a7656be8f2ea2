"""``eval … sim=planar,mujoco``: two engines on the same episodes."""

import json
from pathlib import Path

import pytest

from flipperctl.evaluation.workers import EpisodeRunner
from tests.cli.call import call, refused

HIGH = ("terrain=step", "terrain.low=0.4", "terrain.high=0.4", "sim.friction=0.6")


def test_engines_stand_side_by_side_and_failures_have_causes_and_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flipperctl.evaluation.pictures.draw_scenes", lambda *given: None)
    asked = ("eval", "okada", "sim=planar,mujoco", *HIGH, "--episodes", "1", "--output", "out")
    done = call(*asked, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "planar → mujoco" in done.out
    assert "step, episode 0: traction (stuck after " in done.out
    document = json.loads((tmp_path / "out" / "summary.json").read_text())
    names = [scene["conditions"]["sim"]["name"] for scene in document["scenes"]]
    assert names == ["planar", "mujoco"]
    assert document["engines"][0]["causes"] == {"traction": 1}
    records = sorted((tmp_path / "out").glob("failure_*_0.json"))
    sims = [json.loads(file.read_text())["config"]["sim"]["name"] for file in records]
    assert sorted(sims) == ["mujoco", "planar"]
    monkeypatch.setattr(EpisodeRunner, "play", lambda self, index: 1 / 0)
    again = call(*asked, "--json", cwd=tmp_path)  # nothing is played a second time
    assert json.loads(again.out) == document


def test_the_default_engine_is_not_compared_with_itself(tmp_path: Path) -> None:
    error = refused("eval", "okada", "sim=planar,planar", cwd=tmp_path)
    assert "another engine is compared with planar, as in sim=planar,mujoco" in error
