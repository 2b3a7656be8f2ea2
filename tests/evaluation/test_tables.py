"""The tables of an evaluation for papers."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest

from flipperctl.evaluation.conditions import Conditions, scene_names
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.results import EvaluationResult, SceneResult
from flipperctl.evaluation.scenes import compare
from flipperctl.evaluation.statistics import summarise
from flipperctl.evaluation.tables import interval_text, latex, write_tables
from tests.evaluation.samples import sample

pytestmark = pytest.mark.usefixtures("core_measures")

CONDITIONS = Conditions("nominal", {}, {})


def result() -> EvaluationResult:
    """Return the result of a policy that reached the finish five times, its baseline once."""
    ours = [sample(i, "reached", value) for i, value in enumerate((1.0, 2.0, 3.0, 4.0, 5.0))]
    theirs = [sample(i, "stuck" if i else "reached", 2.0 + i) for i in range(5)]
    other = compare("steep_step", ours, "level", theirs)
    summary = summarise("steep_step", ours)
    scene = SceneResult("runs/a&b_50%", summary, 7, CONDITIONS, (other,), tuple(ours))
    return EvaluationResult((scene,))


def test_a_mean_without_an_interval_has_a_dash() -> None:
    found = Interval(1.984, 1.5, 2.0)
    assert interval_text(found) == "1.98 [1.50, 2.00]"
    assert interval_text(found, 1, sign="+") == "+2.0 [+1.5, +2.0]"
    assert interval_text(Interval(1.984, None, None)) == "1.98 [–]"
    assert interval_text(None) == "–"


def test_the_csv_has_a_row_for_each_scene_and_method(tmp_path: Path) -> None:
    write_tables(tmp_path, result())
    ours, theirs = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    # Of 1 to 5 the half width of the interval is 2.776445 · √(2.5 / 5) = 1.9632.
    assert ours == {
        "scene": "steep_step", "method": "runs/a&b_50%", "n": "5", "reached": "5",
        "success": "1.0", "success_low": "0.5655", "success_high": "1.0",
        "t_cost": "30.0", "t_cost_low": "10.3676", "t_cost_high": "49.6324",
        "pitch_variation_100hz": "6.0",
        "pitch_variation_100hz_low": "2.0735", "pitch_variation_100hz_high": "9.9265",
        "pitch_variation": "3.0", "pitch_variation_low": "1.0368", "pitch_variation_high": "4.9632",
        "max_pitch": "0.3", "max_pitch_low": "0.1037", "max_pitch_high": "0.4963",
        "flipper_travel": "9.0", "flipper_travel_low": "3.1103", "flipper_travel_high": "14.8897",
        "not_reached_pitch_variation_100hz": "",
        "not_reached_pitch_variation_100hz_low": "", "not_reached_pitch_variation_100hz_high": "",
        "seed": "7", "conditions": "nominal", "conditions_hash": CONDITIONS.hash,
    }  # fmt: skip
    assert (theirs["method"], theirs["n"], theirs["reached"]) == ("level", "5", "1")
    # One episode reached the finish, so its mean has no interval; the largest pitch is of all.
    assert (theirs["t_cost"], theirs["t_cost_low"], theirs["t_cost_high"]) == ("20.0", "", "")
    assert (theirs["max_pitch"], theirs["max_pitch_low"]) == ("0.4", "0.2037")
    assert theirs["not_reached_pitch_variation_100hz"] == "9.0"  # of 6, 8, 10 and 12


def test_the_tabular_escapes_names_and_marks_missing_intervals() -> None:
    lines = latex(result()).splitlines()
    conditions = f"nominal {CONDITIONS.hash}"
    assert lines[0] == rf"% steep\_step: seed 7, conditions {conditions}"
    assert lines[2] == r"\begin{tabular}{lllrrrrrrrrr}"
    assert lines[3] == r"\toprule"
    assert lines[6] == (
        rf"steep\_step & {conditions} & runs/a\&b\_50\% & 5 & 5 & 1.000 [0.566, 1.000] & "
        r"30.0 [10.4, 49.6] & 6.00 [2.07, 9.93] & 3.00 [1.04, 4.96] & 0.30 [0.10, 0.50] & "
        r"9.00 [3.11, 14.89] & -- \\"
    )
    assert lines[7] == (
        rf"steep\_step & {conditions} & level & 5 & 1 & 0.200 [0.036, 0.624] & "
        r"20.0 [--] & 4.00 [--] & 2.00 [--] & 0.40 [0.20, 0.60] & 6.00 [--] & 9.00 [--] \\"
    )
    assert lines[8:] == [r"\bottomrule", r"\end{tabular}"]
    assert all(line.count("&") - line.count(r"\&") == 11 for line in lines[4:8:2])


def test_rows_of_several_conditions_can_be_told_apart() -> None:
    """Each row of the tabular has its conditions, and so has each name in the terminal."""
    varied = Conditions("varied", {}, {})
    (first,) = result().scenes
    both = EvaluationResult((first, replace(first, conditions=varied)))
    rows = [line for line in latex(both).splitlines() if line.startswith(r"steep\_step")]
    assert len(set(rows)) == len(rows) == 4
    names = scene_names([(scene.terrain, scene.conditions) for scene in both.scenes])
    assert names == [f"steep_step, nominal {CONDITIONS.hash}", f"steep_step, varied {varied.hash}"]
