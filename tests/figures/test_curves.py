"""Learning curves over seeds, with numbers worked by hand."""

import math

import numpy as np
import pytest

from flipperctl.errors import RequestError
from flipperctl.figures.curves import curves_figure, over_seeds, running_mean
from flipperctl.text.files import CsvRow

Rows = list[CsvRow]


def validations(*values: float, rate: float = 1.0) -> Rows:
    """Return the rows of a run with a validation at each hundredth decision."""
    return [
        CsvRow(
            {
                "kind": "validation",
                "decision": f"{100 * (at + 1)}",
                "success_rate": f"{rate}",
                "pitch_variation_100hz": f"{value}",
                "return": f"{10 * value}",
            }
        )
        for at, value in enumerate(values)
    ]


def episodes(count: int, outcome: str = "reached") -> Rows:
    return [
        CsvRow(
            {
                "kind": "episode",
                "decision": f"{10 * (at + 1)}",
                "outcome": outcome if at % 2 else "reached",
                "pitch_variation_100hz": f"{1 + at % 2}",
                "loss": "" if at < 3 else "0.1",
            }
        )
        for at in range(count)
    ]


def test_a_band_is_the_range_of_few_seeds_and_ends_with_the_shortest() -> None:
    seeds = [validations(3, 2, 1), validations(5, 4, 3, 9), validations(4, 3, 2)]
    curve = over_seeds(seeds, "return", True, 10, "mean")
    assert curve.decisions.tolist() == [100, 200, 300]
    assert curve.middle.tolist() == [40, 30, 20]
    assert curve.low.tolist() == [30, 20, 10]
    assert curve.high.tolist() == [50, 40, 30]


def test_the_band_of_five_seeds_is_an_interval_of_their_mean_or_of_the_middle_half() -> None:
    seeds = [validations(v, v) for v in (1.0, 2.0, 3.0, 4.0, 90.0)]
    mean = over_seeds(seeds, "pitch_variation_100hz", True, 10, "mean")
    middle = over_seeds(seeds, "pitch_variation_100hz", True, 10, "iqm")
    assert mean.middle[0] == 20.0
    assert middle.middle[0] == 3.0  # without the smallest and the largest
    assert 1.0 < mean.low[0] < 20.0 < mean.high[0] < 90.0


def test_pitch_variation_is_that_of_reached_episodes() -> None:
    failed = over_seeds([validations(2.0, rate=0.0)], "pitch_variation_100hz", True, 10, "mean")
    assert np.isnan(failed.middle).all()
    played = over_seeds([episodes(12, "stuck")], "pitch_variation_100hz", False, 10, "mean")
    assert played.middle.tolist() == [1.0] * 12
    success = over_seeds([episodes(12, "stuck")], "success", False, 10, "mean")
    assert success.middle[-1] == 50.0


def test_a_single_run_shows_its_training_and_its_validations() -> None:
    figure = curves_figure({"run": [[*episodes(40), *validations(3, 2)]]}, ["success", "loss"])
    success, loss = figure.axes
    assert [line.get_label() for line in success.get_lines()] == [
        "training, last 10 episodes", "validation",
    ]  # fmt: skip
    assert len(loss.get_lines()) == 1
    assert loss.get_yscale() == "log"
    early = curves_figure({"run": [episodes(2)]}, ["success"]).axes[0]
    assert len(early.get_lines()) == 1


@pytest.mark.parametrize(
    ("rows", "metric", "words"),
    [
        (validations(1), "retur", "did you mean 'return'?"),
        (validations(1), "loss", "known: success, pitch_variation_100hz, return"),
        ([], "return", "run: there is no episode in it yet"),
    ],
)
def test_what_cannot_be_drawn(rows: Rows, metric: str, words: str) -> None:
    with pytest.raises(RequestError, match=words.replace("?", r"\?")):
        curves_figure({"run": [rows]}, [metric])


def test_running_mean_by_hand() -> None:
    values = np.array([math.nan, 1.0, 3.0, math.nan, 5.0])
    expected = [math.nan, 1.0, 2.0, 3.0, 5.0]
    assert running_mean(values, 2) == pytest.approx(np.array(expected), nan_ok=True)
