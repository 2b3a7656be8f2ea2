"""Agreement with rliable and statsmodels on stored examples, to 1e-9.

``benchmarks/agreement.py`` made the file; its head names the versions.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.evaluation import seeds as aggregates
from flipperctl.evaluation import statistics as intervals

STORED = json.loads((Path(__file__).parent / "recorded" / "agreement.json").read_text())
OTHERS = STORED["statsmodels"]


def same(expected: Any) -> Any:
    return pytest.approx(expected, abs=1e-9, rel=1e-9)


@pytest.mark.parametrize("example", STORED["rliable"])
def test_aggregates_equal_those_of_rliable(example: dict[str, Any]) -> None:
    ours, theirs = np.array(example["ours"]), np.array(example["theirs"])
    assert float(aggregates.interquartile_mean(ours)) == same(example["interquartile_mean"])
    assert float(aggregates.improvement(ours, theirs)) == same(example["improvement"])
    found = aggregates.profile(ours, np.array(example["levels"]))
    assert found == same(np.array(example["profile"]))


def test_intervals_and_tests_equal_those_of_statsmodels() -> None:
    mean = OTHERS["mean"]
    found = intervals.interval(mean["values"])
    assert [found.low, found.high] == same(mean["ends"])
    assert intervals.mean_p(mean["values"]) == same(mean["p"])
    for one in OTHERS["wilson"]:
        found = intervals.proportion(one["count"], one["total"])
        assert [found.low, found.high] == same(one["ends"])
    for one in OTHERS["mcnemar"]:
        assert intervals.mcnemar_p(one["won"], one["lost"]) == same(one["p"])
    assert intervals.holm(OTHERS["holm"]["p"]) == same(OTHERS["holm"]["corrected"])


def test_the_parts_of_the_variance_are_an_analysis_of_variance() -> None:
    crossed = OTHERS["crossed"]
    scores = np.array(crossed["scores"])
    seeds, episodes, rest = aggregates._parts({"stair": scores})
    assert seeds is not None
    assert episodes is not None
    assert seeds.variance * scores.size == same(crossed["seed"])
    assert episodes.variance * scores.size == same(crossed["episode"])
    assert rest * scores.size == same(crossed["residual"])
