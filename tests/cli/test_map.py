"""``flipperctl map``."""

import csv
import json
from pathlib import Path

import pytest

from flipperctl.errors import WriteError
from flipperctl.evaluation.workers import EpisodeRunner
from tests.cli.call import call, refused

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


def test_a_map_as_text(tmp_path: Path) -> None:
    done = call(*MAP, "robot.chassis_mass=30:31:3,sim.friction=0.9:1:2", cwd=tmp_path)
    assert [line.split() for line in done.out.splitlines()[2:5]] == [
        ["1", "100", "100", "100"],
        ["0.9", "100", "100", "100"],
        ["30", "30.5", "31"],  # as many digits as tell them apart
    ]


def test_a_full_disk_does_not_lose_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(folder: Path, found: object) -> None:
        raise WriteError(f"{folder}: writing failed half way (No space left on device)")

    monkeypatch.setattr("flipperctl.evaluation.views.map.write", full)
    axes = "terrain.height=0.3:0.4:2,sim.friction=1:1.1:2"
    done = call(*MAP, axes, "--output", "found", cwd=tmp_path)
    assert (done.code, "4 of 4 points played" in done.out) == (1, True)
    assert "writing failed half way" in done.err.splitlines()[-1]


def test_two_processes_make_the_map_of_one(tmp_path: Path) -> None:
    words = ("terrain.height=0.3:0.4:2,episode.run_out=0.2:0.4:2", "episode.run_up=0.8", "--json")
    one, two = (call(*MAP, *words, "--jobs", jobs, cwd=tmp_path) for jobs in ("1", "2"))
    assert one.code == two.code == 0
    assert len(json.loads(one.out)["cells"]) == 4
    assert one.out == two.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "name two settings, as in --over terrain.height="),
        (["--over", "terrain.hight,sim.friction"], "did you mean 'terrain.height_low'"),
        (["--over", "terrain.height=0.1:2,sim.friction"], "terrain.height_low"),
        (["--over", "terrain.height,sim.iterations=7:7.3:2"], "two different values are needed"),
        (["--over", AXES, "suite=paper"], "suite=…: map takes one scene"),
        (["--over", AXES, "eval.ray=auto"], "eval.ray: a map is played here"),
        (["--over", AXES, "sim=planar,mujoco"], "map takes one scene; the settings give 2"),
        (["--over", AXES, "generalist"], "map takes one policy; okada, generalist are given"),
    ],
)
def test_a_wrong_request_is_one_error(arguments: list[str], words: str, tmp_path: Path) -> None:
    error = refused("map", "okada", "terrain=uplift", *arguments, cwd=tmp_path)
    assert words in error
    assert error.count("\n") == 1


def test_a_map_tells_where_a_controller_changes(tmp_path: Path) -> None:
    """The learned values of ``mpc`` fit its robot alone."""
    axes = "robot.flipper_length=0.5:0.6:2,sim.friction=0.9:1:2"
    words = ("controller.beam=1", "controller.horizon=1", "--episodes", "1")
    done = call("map", "mpc", "terrain=flat", *words, "--over", axes, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "in a part of the map, such as robot.flipper_length=0." in done.err
    assert "plans have the hand-set cost instead" in done.err
