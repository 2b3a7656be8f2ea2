"""What the rows of runs and sweeps say of validations."""

from pathlib import Path

from flipperctl.runs.comparison import SweepRun
from flipperctl.runs.summary import of_reached


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
