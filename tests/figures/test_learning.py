"""Learning curves of a run."""

import math
from pathlib import Path

import numpy as np
import pytest

from flipperctl.figures.figure import save
from flipperctl.figures.learning import column, learning_figure, running_mean
from tests.figures.test_figures import texts


def rows(episodes: int) -> list[dict[str, str]]:
    return [
        {
            "decision": str(40 * i),
            "outcome": "reached" if i % 2 else "stuck",
            "return": "-3.5",
            "pitch_variation_100hz": "2.5",
            "epsilon": "0.5",
            "loss": "" if i < 3 else "0.1",
        }
        for i in range(episodes)
    ]


VALIDATIONS = [{"decision": "5000", "success_rate": "0.75", "pitch_variation": "", "t_cost": ""}]


def test_learning_has_four_panels_and_an_axis_of_epsilon() -> None:
    figure = learning_figure(rows(200), VALIDATIONS, "run")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert [label.split("[")[0].split("$")[0].strip() for label in labels] == [
        "success", "", "return", "loss", "ε, random actions",
    ]  # fmt: skip
    begin, curve, points = figure.axes[0].get_lines()
    assert len(begin.get_xdata()) == 100
    assert begin.get_linewidth() < curve.get_linewidth()
    assert np.asarray(curve.get_xdata())[0] == 99 * 40
    assert np.asarray(curve.get_ydata())[-1] == 50.0
    assert np.asarray(points.get_ydata()).tolist() == [75.0]


@pytest.mark.parametrize("episodes", [0, 1])
def test_learning_from_the_first_row_on(episodes: int, tmp_path: Path) -> None:
    save(learning_figure(rows(episodes), [], "run"), tmp_path / "run.svg")


def test_the_panel_of_swing_shows_100_hz_and_a_run_without_it_only_the_papers() -> None:
    swings = {"pitch_variation_100hz": "1.5", "pitch_variation": "1.25"}
    found = learning_figure(rows(3), [{**VALIDATIONS[0], **swings}], "run").axes[1].get_lines()
    assert [line.get_ydata()[-1] for line in found[-2:]] == [1.5, 1.25]
    earlier = [{**VALIDATIONS[0], "pitch_variation": "1.25"}]
    found = learning_figure(rows(3), earlier, "run").axes[1].get_lines()
    assert np.isnan(found[-2].get_ydata()).all()
    assert found[-1].get_ydata()[-1] == 1.25


def test_the_panel_of_swing_leaves_out_what_did_not_reach_the_finish() -> None:
    """A robot that overturns at once rocks little."""
    swings = {"pitch_variation_100hz": "0.3", "pitch_variation": "0.25"}
    failed = [{**VALIDATIONS[0], **swings, "success_rate": "0.0"}]
    dots, begin, *checked = learning_figure(rows(4), failed, "run").axes[1].get_lines()
    expected = [math.nan, 2.5, math.nan, 2.5]
    assert np.asarray(dots.get_ydata()) == pytest.approx(expected, nan_ok=True)
    assert np.asarray(begin.get_ydata())[-1] == 2.5
    assert all(np.isnan(line.get_ydata()).all() for line in checked)


def test_a_run_without_an_update_says_so() -> None:
    unlearned = [{**row, "loss": ""} for row in rows(3)]
    assert "no update yet" in texts(learning_figure(unlearned, [], "run"))


def test_running_mean_by_hand() -> None:
    values = np.array([math.nan, 1.0, 3.0, math.nan, 5.0])
    expected = [math.nan, 1.0, 2.0, 3.0, 5.0]
    assert running_mean(values, 2) == pytest.approx(np.array(expected), nan_ok=True)


def test_a_bad_cell_is_named() -> None:
    with pytest.raises(ValueError, match=r"row 2, loss: a number is allowed; got 'high'"):
        column([{"loss": ""}, {"loss": "high"}], "loss")
