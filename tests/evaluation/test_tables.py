"""The tables of an evaluation for papers."""

import csv
from pathlib import Path

from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.results import EvaluationResult, Interval, SceneResult
from flipperctl.evaluation.scenes import compare
from flipperctl.evaluation.statistics import summarise
from flipperctl.evaluation.tables import interval_text, latex, write_tables
from tests.evaluation.samples import sample

CONDITIONS = Conditions("nominal", {}, {})


def result() -> EvaluationResult:
    """Return the result of a policy that reached the finish twice, its baseline once."""
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 3.0)]
    theirs = [sample(0, "reached", 2.0), sample(1, "stuck", 4.0)]
    other = compare("steep_step", ours, "level", theirs)
    scene = SceneResult(summarise("steep_step", ours), 7, CONDITIONS, (other,), tuple(ours))
    return EvaluationResult("runs/a&b_50%", (scene,))


def test_a_mean_over_one_episode_has_no_interval() -> None:
    found = Interval(1.984, 1.5, 2.0)
    assert interval_text(found, 2) == "1.98 [1.50, 2.00]"
    assert interval_text(found, 2, 1, sign="+") == "+2.0 [+1.5, +2.0]"
    assert interval_text(found, 1) == "1.98 [–]"
    assert interval_text(None, 0) == "–"


def test_the_csv_has_a_row_for_each_scene_and_method(tmp_path: Path) -> None:
    write_tables(tmp_path, result())
    ours, theirs = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert ours == {
        "scene": "steep_step", "method": "runs/a&b_50%", "n": "2", "reached": "2",
        "success": "1.0", "success_low": "0.3424", "success_high": "1.0",
        "t_cost": "20.0", "t_cost_low": "10.0", "t_cost_high": "30.0",
        "pitch_variation_100hz": "4.0",
        "pitch_variation_100hz_low": "2.0", "pitch_variation_100hz_high": "6.0",
        "pitch_variation": "2.0", "pitch_variation_low": "1.0", "pitch_variation_high": "3.0",
        "max_pitch": "0.2", "max_pitch_low": "0.1", "max_pitch_high": "0.3",
        "seed": "7", "conditions": "nominal", "conditions_hash": CONDITIONS.hash,
    }  # fmt: skip
    assert (theirs["method"], theirs["n"], theirs["reached"]) == ("level", "2", "1")
    # One episode reached the finish, so its mean has no interval; the largest pitch is of both.
    assert (theirs["t_cost"], theirs["t_cost_low"], theirs["t_cost_high"]) == ("20.0", "", "")
    assert (theirs["max_pitch"], theirs["max_pitch_low"]) == ("0.3", "0.2")


def test_the_tabular_escapes_names_and_marks_missing_intervals() -> None:
    lines = latex(result()).splitlines()
    assert lines[0] == rf"% steep\_step: seed 7, conditions nominal {CONDITIONS.hash}"
    assert lines[2] == r"\begin{tabular}{llrrrrrrr}"
    assert lines[3] == r"\toprule"
    assert lines[6] == (
        r"steep\_step & runs/a\&b\_50\% & 2 & 2 & 1.000 [0.342, 1.000] & 20.0 [10.0, 30.0] & "
        r"4.00 [2.00, 6.00] & 2.00 [1.00, 3.00] & 0.20 [0.10, 0.30] \\"
    )
    assert lines[7] == (
        r"steep\_step & level & 2 & 1 & 0.500 [0.095, 0.905] & 20.0 [--] & "
        r"4.00 [--] & 2.00 [--] & 0.30 [0.20, 0.40] \\"
    )
    assert lines[8:] == [r"\bottomrule", r"\end{tabular}"]
    assert all(line.count("&") - line.count(r"\&") == 8 for line in lines[4:8:2])
