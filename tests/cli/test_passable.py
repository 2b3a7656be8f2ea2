"""``eval --passable``: success over the episodes that some reference crosses."""

import csv
import json
from pathlib import Path

import pytest

from tests.cli.call import call, refused

# A step of 0.9 m that no controller crosses, or one of 0.1 m that the others cross.
WALL = "terrain.parts=[{name:step,low:0.9,high:0.9},{name:step,low:0.1,high:0.1}]"
FEW = ["--episodes", "6", "terrain=mix", WALL, "sim.friction=0.8"]


def test_a_draw_that_nobody_crosses_counts_against_nobody(tmp_path: Path) -> None:
    asked = ("eval", "level", "--passable", "okada,random", *FEW)
    done = call(*asked, "--json", "--output", "evaluated", cwd=tmp_path)
    assert done.code == 0, done.err
    (scene,) = json.loads(done.out)["scenes"]
    text = (tmp_path / "evaluated" / "episodes.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    crossed = [row for row in rows if row["crossed_by"]]
    assert 0 < len(crossed) < 6
    assert {row["crossed_by"] for row in crossed} <= {"okada", "random"}
    assert scene["passable"]["episodes"] == len(crossed)
    assert scene["passable"]["success_rate"] == pytest.approx(
        sum(row["outcome"] == "reached" for row in crossed) / len(crossed)
    )
    others = [row for row in rows if not row["crossed_by"]]
    beyond = sum(row["outcome"] == "reached" for row in others)
    assert scene["passable"]["beyond"] == beyond
    done = call(*asked, "--output", "evaluated", cwd=tmp_path)
    assert "of passable" in done.out.splitlines()[1]


def test_an_unknown_one_is_named(tmp_path: Path) -> None:
    error = refused("eval", "level", "--passable", "okda", *FEW, cwd=tmp_path)
    assert "--passable" in error
    assert "'okada'" in error


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
