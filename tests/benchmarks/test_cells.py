"""Rows of one policy on the scenes of a suite, from a folder of ``eval``."""

import csv
import json
from pathlib import Path

import pytest

from benchmarks import cells

SWINGS = {
    "mine": [1.0, 2.0, 1.5, 1.0, 2.0, 1.0, 6.0, 7.0],
    "okada": [2.0, 2.0, 2.5, 2.0, 3.0, 2.0, 3.0, 2.0],
}
FAILED = {"mine": {6, 7}, "okada": {5, 7}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two scenes on equal ground in two engines; the policy fails in two episodes."""
    hashes = {"step": "aaaa", "step in 3-D": "bbbb"}
    scenes = [
        {
            "suite_scene": name,
            "terrain": "step",
            "controller": method,
            "conditions": {"hash": digest, "sim": {"name": "mujoco" if "3" in name else "planar"}},
        }
        for name, digest in hashes.items()
        for method in SWINGS
    ]
    (tmp_path / "summary.json").write_text(json.dumps({"scenes": scenes}))
    with (tmp_path / "episodes.csv").open("w", newline="") as file:
        columns = ["scene", "conditions_hash", "controller", "episode", "outcome"]
        writer = csv.DictWriter(file, [*columns, "pitch_variation_100hz"])
        writer.writeheader()
        for scene in scenes:
            method = str(scene["controller"])
            for index, swing in enumerate(SWINGS[method]):
                failure = "overturned" if index == 7 else "stuck"
                ended = failure if index in FAILED[method] else "reached"
                name = "step in 3-D" if scene["conditions"]["hash"] == "bbbb" else "step"
                values = ["step", hashes[name], method, index, ended, swing]
                writer.writerow(dict(zip(writer.fieldnames, values, strict=True)))
    return tmp_path


def test_a_row_compares_episodes_that_both_reached(folder: Path) -> None:
    first, second = cells.rows(folder)
    assert (first["engine"], second["engine"]) == ("planar", "mujoco")
    assert first["episodes"] == 8
    assert first["reached"] == {"mine": 6, "okada": 6}
    assert first["passable"] == 7  # all but the last one
    assert first["rocked"] == 2  # failures with more than 5 rad
    assert first["overturned"] == {"mine": 1, "okada": 1}
    mean, low, high = first["difference"]["okada"]
    assert mean == pytest.approx(-0.8)  # of episodes 0 to 4
    assert low < mean < high


def test_a_table_has_a_line_for_each_scene(folder: Path) -> None:
    rows = cells.rows(folder)
    lines = list(cells.markdown({"rows": rows}))
    assert lines[0].split(" | ")[3:6] == ["`okada` reached", "overturned", "θ̂_R [rad]"]
    assert lines[2].startswith("| step | 7 | 6 | 6 | 1, 1 | 1.42 | -0.80 [")
    assert len(lines) == 4
    for row in rows:  # as in a file from before they were counted
        del row["overturned"]
    assert "overturned" not in next(cells.markdown({"rows": rows}))
