"""``map``, ``replay``, engines and ``--passable``."""

import csv
import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from flipperctl.api import Robot
from flipperctl.errors import WriteError
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.rollout.trace import Trace
from tests.cli.call import call

AXES = "terrain.height=0.2:0.5:2,sim.friction=0.5:1.0:2"
MAP = ("map", "okada", "terrain=uplift", "--episodes", "1", "--over")


def test_a_map_is_printed_and_written_and_its_failures_can_be_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = call(*MAP, AXES, "--output", "found", "--json", cwd=tmp_path)
    assert done.code == 0
    document = json.loads(done.out)
    assert document == json.loads((tmp_path / "found/map.json").read_text())
    assert [cell["success_rate"] for cell in document["cells"]] == [1.0, 0.0, 1.0, 0.0]
    assert document["episodes_per_cell"] == 1
    with (tmp_path / "found/map.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["sim.friction"] for row in rows] == ["0.5", "0.5", "1.0", "1.0"]
    assert (tmp_path / "found/map.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(file.name for file in tmp_path.glob("found/failure_*")) == [
        "failure_map_1_0_0.json",
        "failure_map_1_1_0.json",
    ]
    done = call("replay", "found/failure_map_1_0_0.json", cwd=tmp_path)
    assert (done.code, "bit-identical" in done.out) == (0, True)
    monkeypatch.setattr(EpisodeRunner, "play", lambda self, index: 1 / 0)
    again = call(*MAP, AXES, "--output", "found", "--json", cwd=tmp_path)
    assert json.loads(again.out) == document  # nothing was played a second time


def test_a_map_as_text_which_a_full_disk_does_not_lose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(folder: Path, found: object) -> None:
        raise WriteError(f"{folder}: writing failed half way (No space left on device)")

    monkeypatch.setattr("flipperctl.views.map.write", full)
    axes = "robot.chassis_mass=30:31:3,sim.friction=0.9:1:2"
    done = call(*MAP, axes, "--output", "found", cwd=tmp_path)
    assert [line.split() for line in done.out.splitlines()[2:5]] == [
        ["1", "100", "100", "100"],
        ["0.9", "100", "100", "100"],
        ["30", "30.5", "31"],  # as many digits as tell them apart
    ]
    assert done.code == 1
    assert "writing failed half way" in done.err.splitlines()[-1]


LEVEL = ("eval", "level", "terrain=step", "terrain.height=0.4", "--episodes", "1")
RECORD = "found/failure_step_0.json"


def test_a_failure_is_recorded_and_played_again_with_pictures_of_its_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot is sampled; a nominal one would hover above the ground or lie in it."""
    drawn = []

    def figure(trace: Trace) -> Figure:
        drawn.append(trace.robot.track_radius)
        return Figure()

    monkeypatch.setattr("flipperctl.figures.episode.episode_figure", figure)
    size = "randomise.robot.size=[0.8,0.8]"
    done = call(*LEVEL, size, "--output", "found", cwd=tmp_path)
    assert done.code == 0
    assert f"recorded 1 failure; to play it again: flipperctl replay {RECORD}" in done.err
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


HIGH = ("terrain=step", "terrain.height=0.4", "sim.friction=0.6")


def test_engines_stand_side_by_side_and_failures_have_causes_and_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flipperctl.requests.traces.Traces.record", lambda *given: None)
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


FAILS = """
from flipperctl.api import Controller, Perception, controller

@controller("fails")
class Fails(Controller):
    \"\"\"A rule that fails.\"\"\"

    def act(self, p: Perception) -> int:
        raise ValueError("boom")
"""


def test_a_reference_that_fails_leaves_it_unknown(tmp_path: Path) -> None:
    (tmp_path / "fails.py").write_text(FAILS)
    settings = ("--plugins", "fails.py", "--passable", "fails,okada", "--episodes", "1")
    done = call(
        *("eval", "level", "--baseline", "none", *settings, "terrain=flat"),
        *("--json", "--output", "evaluated"),
        cwd=tmp_path,
    )
    assert "fails failed" in done.err
    (scene,) = json.loads(done.out)["scenes"]
    assert "passable" not in scene
    assert "crossed_by" not in (tmp_path / "evaluated" / "episodes.csv").read_text()
