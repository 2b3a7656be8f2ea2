"""Medians, quartiles and ratios, by hand."""

import pytest

from benchmarks.settings import ratio
from flipperctl.bench import measure_in_turn, quantity


def test_a_quantity_keeps_its_raw_numbers_and_has_quartiles_between_neighbours() -> None:
    found = quantity([4.0, 1.0, 3.0, 2.0, 5.0], "1/s")
    assert (found["low"], found["median"], found["high"]) == (2.0, 3.0, 4.0)
    assert (found["values"], found["unit"]) == ([4.0, 1.0, 3.0, 2.0, 5.0], "1/s")
    found = quantity([1.0, 2.0], "s")
    assert (found["low"], found["median"], found["high"]) == (1.25, 1.5, 1.75)


def test_an_unfinished_run_counts_as_longer_than_any() -> None:
    found = quantity([10.0, None, 30.0, None, 20.0], "s")
    assert found["median"] == 30.0
    assert found["low"] == 20.0
    assert found["high"] is None
    assert quantity([10.0, None, None], "s")["median"] is None


def test_a_ratio_is_of_medians_and_its_spread_of_pairs() -> None:
    found = ratio([2.0, 9.0, 4.0], [1.0, 3.0, 4.0])  # pairs 2, 3, 1; medians 4 and 3
    assert found["ratio"] == pytest.approx(4 / 3)
    assert (found["low"], found["high"], found["rounds"]) == (1.5, 2.5, 3)


def test_a_ratio_of_unfinished_runs() -> None:
    assert ratio([None], [5.0]) == {"ratio": None, "low": None, "high": None, "rounds": 1}
    assert ratio([None], [None])["rounds"] == 0
    assert ratio([5.0], [None])["low"] == 0.0


def test_contestants_take_turns() -> None:
    order: list[str] = []

    def runner(name: str):
        return lambda: order.append(name) or float(len(order))

    fractions: list[float] = []
    found = measure_in_turn({"a": runner("a"), "b": runner("b")}, 3, fractions.append)
    assert order == ["a", "b", "a", "b", "a", "b"]
    assert found == {"a": [1.0, 3.0, 5.0], "b": [2.0, 4.0, 6.0]}
    assert fractions[-1] == 1.0
