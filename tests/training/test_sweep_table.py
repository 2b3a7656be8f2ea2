"""What the rows of runs and sweeps say of validations, and which rows stay."""

import csv
from pathlib import Path

from flipperctl.training.sweep import FILE, SweepRun, of_reached, write_comparison


def test_a_validation_that_reached_nothing_has_no_way_to_the_finish(tmp_path: Path) -> None:
    best = {
        "success_rate": 0.0,
        "pitch_variation_100hz": 0.9,
        "pitch_variation": 0.8,
        "t_cost": 21.0,
    }
    row = SweepRun(0, {}, tmp_path, None, {"best": {**best, "decision": 7}}).row()
    ways = [row[name] for name in ("pitch_variation_100hz", "pitch_variation", "t_cost")]
    assert (row["success_rate"], row["best_decision"], ways) == (0.0, 7, [None] * 3)
    assert of_reached({**best, "success_rate": 0.1}) == {**best, "success_rate": 0.1}
    assert of_reached({**best, "return": 1.0})["return"] == 1.0


def rows(folder: Path) -> list[tuple[str, str]]:
    with (folder / FILE).open(encoding="utf-8", newline="") as file:
        return [(row["job"], row["folder"]) for row in csv.DictReader(file)]


def test_a_sweep_that_was_moved_has_each_run_once(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    write_comparison(sweep, [SweepRun(i, {}, sweep / f"{i}_a", None, {}) for i in range(2)])
    moved = sweep.rename(tmp_path / "moved")
    write_comparison(moved, [SweepRun(0, {}, moved / "0_a", None, {})])
    assert rows(moved) == [("0", str(moved / "0_a")), ("1", str(sweep / "1_a"))]


def test_a_damaged_table_of_a_sweep_is_written_anew(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"job,folder\n0,\xff")
    write_comparison(tmp_path, [SweepRun(0, {}, tmp_path / "0_a", None, {})])
    assert rows(tmp_path) == [("0", str(tmp_path / "0_a"))]
