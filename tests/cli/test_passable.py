"""``eval --passable``: success over the episodes that some reference crosses."""

import csv
import json
from pathlib import Path

import pytest
from rich.cells import cell_len

from tests.cli.call import call

# A step of 0.9 m that no controller crosses, or one of 0.1 m that the others cross.
WALL = "terrain.parts=[{name:step,low:0.9,high:0.9},{name:step,low:0.1,high:0.1}]"
PLACES = ("terrain", "│ mix")
FEW = ["--episodes", "6", "terrain=mix", WALL, "sim.friction=0.8"]


def test_a_draw_that_nobody_crosses_counts_against_nobody(tmp_path: Path) -> None:
    done = call(
        *("eval", "--controller", "level", "--passable", "okada,random", *FEW),
        *("--json", "--output", "evaluated"),
        cwd=tmp_path,
    )
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


def test_the_table_shows_it(tmp_path: Path) -> None:
    done = call("eval", "--controller", "level", "--passable", "okada", *FEW, cwd=tmp_path)
    heads, row = (next(line for line in done.out.splitlines() if word in line) for word in PLACES)
    assert "passable" in heads
    assert "beyond" in heads
    assert cell_len(heads) == cell_len(row)


def test_an_unknown_one_is_named(tmp_path: Path) -> None:
    done = call("eval", "--controller", "level", "--passable", "okda", *FEW, cwd=tmp_path)
    assert done.code == 2
    assert "--passable" in done.err
    assert "'okada'" in done.err


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
        *("eval", "--controller", "level", "--baseline", "none", *settings, "terrain=flat"),
        *("--json", "--output", "evaluated"),
        cwd=tmp_path,
    )
    assert "fails failed" in done.err
    (scene,) = json.loads(done.out)["scenes"]
    assert "passable" not in scene
    assert "crossed_by" not in (tmp_path / "evaluated" / "episodes.csv").read_text()
