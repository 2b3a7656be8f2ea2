"""Intervals and tests, by hand and against published or exact numbers, to 1e-9.

``benchmarks/agreement.py`` made the file of numbers of rliable and statsmodels; its head names the
versions.
"""

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.evaluation import seeds as aggregates
from flipperctl.evaluation.statistics import (
    FEWEST,
    Interval,
    Z,
    holm,
    interval,
    mcnemar_p,
    mean_of,
    mean_p,
    paired_success,
    proportion,
)


def test_the_interval_of_a_mean_is_students() -> None:
    # Of 1 to 5: standard deviation √2.5, t(4) = 2.776445, so 3 ± 2.776445 · √(2.5 / 5).
    found = interval([1.0, 2.0, 3.0, 4.0, 5.0])
    assert found.mean == 3.0
    assert found.low == pytest.approx(3 - 2.776445 * math.sqrt(0.5), abs=1e-6)
    assert found.high == pytest.approx(3 + 2.776445 * math.sqrt(0.5), abs=1e-6)
    # 50 zeros and 50 ones: standard error √(25 / 99) / 10, t(99) = 1.984217.
    wide = interval([0.0] * 50 + [1.0] * 50)
    assert wide.low == pytest.approx(0.5 - 1.984217 * math.sqrt(25 / 99) / 10, abs=1e-6)


def test_few_values_have_no_interval() -> None:
    for count in range(1, FEWEST):
        assert interval([1.0, 3.0, 2.0, 2.0][:count]) == Interval(
            pytest.approx(sum([1.0, 3.0, 2.0, 2.0][:count]) / count), None, None
        )
    assert interval([2.0] * FEWEST) == Interval(2.0, 2.0, 2.0)
    with pytest.raises(ValueError, match="at least one value"):
        interval([])


def test_the_p_value_of_a_mean_is_that_of_its_interval() -> None:
    rng = np.random.default_rng(3)
    for shift, count in itertools.product((0.0, 0.3, 0.8), (5, 9, 40)):
        values = rng.normal(shift, 1.0, count).tolist()
        found = interval(values)
        assert found.low is not None
        assert found.high is not None
        assert (mean_p(values) <= 0.05) == (found.low >= 0 or found.high <= 0)
    # t = 3 / √(2.5 / 5) = 4.242641 with four degrees of freedom.
    assert mean_p([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(0.0132356, abs=1e-6)
    assert mean_p([1.0] * 4) == 1.0
    assert mean_p([0.0] * 9) == 1.0
    assert mean_p([1.0] * 9) == 0.0


def test_the_interval_of_a_rate_is_wilsons() -> None:
    # z² = 3.84146. Of 5 of 5: low = 5 / (5 + z²); of 0 of 5: high = z² / (5 + z²).
    assert proportion(5, 5) == Interval(1.0, pytest.approx(0.56552, abs=1e-5), 1.0)
    assert proportion(0, 5) == Interval(0.0, 0.0, pytest.approx(0.43448, abs=1e-5))
    # Of 50 of 100: 0.5 ± z · √(0.25 / (100 + z²)) = 0.5 ± 0.09617.
    assert proportion(50, 100).low == pytest.approx(0.40383, abs=1e-5)
    assert proportion(50, 100).high == pytest.approx(0.59617, abs=1e-5)
    # Of 9 of 10: centre (0.9 + 0.192073) / 1.384146 = 0.788987, half width 0.193136.
    assert proportion(9, 10).low == pytest.approx(0.59585, abs=1e-5)
    assert proportion(9, 10).high == pytest.approx(0.98212, abs=1e-5)
    every = [proportion(k, n) for n in range(1, 60) for k in range(n + 1)]
    assert all(0 <= (one.low or 0.0) <= one.mean <= (one.high or 0.0) <= 1 for one in every)
    with pytest.raises(ValueError, match="at least one outcome"):
        proportion(0, 0)


@pytest.mark.parametrize("total", [5, 10, 40])
def test_equal_pairs_prove_no_equality(total: int) -> None:
    # With no unequal pair, n · d² = z² · |d| · (1 − |d|), so |d| = z² / (n + z²).
    found = paired_success(0, 0, total)
    assert found.mean == 0.0
    assert found.high == pytest.approx(Z**2 / (total + Z**2), abs=1e-9)
    assert found.low == pytest.approx(-(Z**2) / (total + Z**2), abs=1e-9)
    with pytest.raises(ValueError, match="at least one pair"):
        paired_success(0, 0, 0)


PAIRS = [(3, 1, 10), (0, 4, 12), (7, 7, 30), (5, 0, 5)]


@pytest.mark.parametrize(("won", "lost", "total"), PAIRS)
def test_the_ends_of_a_paired_difference_solve_the_score_equation(
    won: int, lost: int, total: int
) -> None:
    """The rates under each end are found by trying 200,001 of them."""
    found = paired_success(won, lost, total)
    assert found.mean == (won - lost) / total
    for end, sign in ((found.low, 1), (found.high, -1)):
        assert end is not None
        if abs(end) == 1:
            continue
        rates = np.linspace(max(0.0, -end), (1 - end) / 2, 200_001)[1:-1]  # the second's alone
        either = total - won - lost
        likelihood = (
            won * np.log(rates + end)
            + (lost * np.log(rates) if lost else 0.0)
            + (either * np.log(1 - end - 2 * rates) if either else 0.0)
        )
        rate = float(rates[np.argmax(likelihood)])
        score = (won - lost - total * end) / math.sqrt(total * (2 * rate + end - end**2))
        assert score == pytest.approx(sign * Z, abs=2e-3)


def test_mcnemars_test_is_exact() -> None:
    for won, lost in ((0, 5), (2, 8), (1, 1), (0, 1), (10, 30)):
        count, few = won + lost, min(won, lost)
        tail = sum(math.comb(count, k) for k in range(few + 1)) / 2**count
        assert mcnemar_p(won, lost) == pytest.approx(min(1.0, 2 * tail))
    assert mcnemar_p(0, 0) == 1.0
    assert mcnemar_p(0, 5) == pytest.approx(2 / 32)


def test_holm_corrects_each_p_value_for_the_others() -> None:
    # In order 0.01 · 4, 0.03 · 3, 0.04 · 2 (raised to the one before), 0.5.
    assert holm([0.01, 0.04, 0.03, 0.5]) == pytest.approx([0.04, 0.09, 0.09, 0.5])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_a_mean_of_rates_without_variation_has_the_width_of_their_intervals() -> None:
    none, all_of_them = proportion(0, 100), proportion(100, 100)
    found = mean_of([none, all_of_them, all_of_them])
    assert found.mean == pytest.approx(2 / 3)
    assert found.low == pytest.approx(2 / 3 - math.sqrt(2 * (1 - (all_of_them.low or 0)) ** 2) / 3)
    assert found.high == pytest.approx(2 / 3 + (none.high or 0) / 3)
    assert mean_of([none]) == none


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
    found = interval(mean["values"])
    assert [found.low, found.high] == same(mean["ends"])
    assert mean_p(mean["values"]) == same(mean["p"])
    for one in OTHERS["wilson"]:
        found = proportion(one["count"], one["total"])
        assert [found.low, found.high] == same(one["ends"])
    for one in OTHERS["mcnemar"]:
        assert mcnemar_p(one["won"], one["lost"]) == same(one["p"])
    assert holm(OTHERS["holm"]["p"]) == same(OTHERS["holm"]["corrected"])


def test_the_parts_of_the_variance_are_an_analysis_of_variance() -> None:
    crossed = OTHERS["crossed"]
    scores = np.array(crossed["scores"])
    seeds, episodes, rest = aggregates._parts({"stair": scores})
    assert seeds is not None
    assert episodes is not None
    assert seeds.variance * scores.size == same(crossed["seed"])
    assert episodes.variance * scores.size == same(crossed["episode"])
    assert rest * scores.size == same(crossed["residual"])
