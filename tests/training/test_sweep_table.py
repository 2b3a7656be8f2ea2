"""What the rows of runs and sweeps say of validations, and which rows stay."""

from pathlib import Path

import pytest

from flipperctl.cli.hydra.sweeps import print_comparison
from flipperctl.errors import RequestError
from flipperctl.text.files import read_csv
from flipperctl.training.sweep import FILE, Sweep, SweepRun, of_reached, write_comparison


def test_a_validation_that_reached_nothing_has_no_way_to_the_finish(tmp_path: Path) -> None:
    best = {
        "success_rate": 0.0,
        "pitch_variation_100hz": 0.9,
        "pitch_variation_decisions": 0.8,
        "t_cost": 21.0,
    }
    row = SweepRun(0, {}, tmp_path, None, {"best": {**best, "decision": 7}}).row()
    ways = [row[name] for name in ("pitch_variation_100hz", "pitch_variation_decisions", "t_cost")]
    assert (row["success_rate"], row["best_decision"], ways) == (0.0, 7, [None] * 3)
    assert of_reached({**best, "success_rate": 0.1}) == {**best, "success_rate": 0.1}
    assert of_reached({**best, "return": 1.0})["return"] == 1.0


def test_a_sweep_that_was_moved_has_each_run_once(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    write_comparison(sweep, [SweepRun(i, {}, sweep / f"{i}_a", None, {}) for i in range(2)])
    moved = sweep.rename(tmp_path / "moved")
    write_comparison(moved, [SweepRun(0, {}, moved / "0_a", None, {})], read_csv(moved / FILE))
    rows = [(row["run"], row["folder"]) for row in read_csv(moved / FILE)]
    assert rows == [("0", str(moved / "0_a")), ("1", str(sweep / "1_a"))]


def test_a_mean_says_of_how_many_runs_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    best = {"pitch_variation_100hz": 2.0, "pitch_variation_decisions": 1.8, "t_cost": 13.0}
    print_comparison(
        tmp_path,
        [
            SweepRun(i, {"seed": f"{i}"}, tmp_path, None, {"best": {**best, "success_rate": rate}})
            for i, rate in enumerate((0.75, 0.0))
        ],
    )
    assert "37.5 %   2.00 (1 of 2 runs)     13.0" in capsys.readouterr().err


def test_a_table_that_cannot_be_read_is_refused_before_any_job(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text("run;folder\n0;0_seed=1\n")
    sweep = Sweep(tmp_path, lambda *_: [], lambda *_: None, named=True, serial=True)
    with pytest.raises(RequestError, match=r"sweep\.csv, line 1: there is no column 'run'"):  # noqa: SIM117
        with sweep.held():
            pytest.fail("a job would begin")
    assert (tmp_path / FILE).read_text() == "run;folder\n0;0_seed=1\n"
