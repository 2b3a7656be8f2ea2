"""How often the intervals over training seeds contain the truth."""

import math

import numpy as np
import pytest

from benchmarks.seed_coverage import EPISODES, SEEDS, SHAPES, coverage, main
from flipperctl.evaluation.seeds import interquartile_mean


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_has_the_stated_mean_and_middle(name: str) -> None:
    drawn = SHAPES[name].draw(np.random.default_rng(0), (1, 200_000))
    assert drawn.mean() == pytest.approx(0.0, abs=0.01)
    assert drawn.std() == pytest.approx(1.0, abs=0.01)
    assert interquartile_mean(drawn) == pytest.approx(SHAPES[name].middle, abs=0.01)


def test_the_mean_holds_where_the_percentile_bootstrap_misses() -> None:
    found = coverage((0.5, 0.1, 0.1), SHAPES["normal"], 3, 150, 0)
    assert found["mean"] > 0.9
    assert found["mean, percentile bootstrap"] < 0.85
    assert math.isnan(found["better"])
    assert found["mean, bootstrap-t of seeds"] < 0.9


def test_the_command_prints_a_column_for_each_number_of_seeds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--repetitions", "2", "--mix", "seeds"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(SHAPES) * (2 + 7)
    assert lines[1].split() == [f"S={count}" for count in SEEDS]
    assert lines[4].split()[1:4] == ["-", "-", "-"]
    (studentized, *_) = (line for line in lines if line.startswith("mean, bootstrap-t of seeds"))
    assert studentized.split()[4] == "-"  # of two seeds
    assert studentized.split()[5] != "-"
    assert EPISODES == 30  # as the documentation says
    with pytest.raises(SystemExit) as left:
        main(["--repetitions", "0"])
    assert left.value.code == 2
