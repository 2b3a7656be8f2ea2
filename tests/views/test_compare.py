"""Methods compared over their training seeds, from outcomes made by hand; their short names."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.evaluation.names import names
from flipperctl.evaluation.seeds import SeedSamples
from flipperctl.evaluation.stored import Stored
from flipperctl.views.compare import ALL, Comparison, document, tables


def method(name: str, *scenes: tuple[int, int]) -> SeedSamples:
    """Return a method that reached the finish in the first episodes of each scene."""
    reached = {f"{n}": (np.arange(of) < many)[None] for n, (many, of) in enumerate(scenes)}
    return SeedSamples(
        name, {scene: np.ones(found.shape) for scene, found in reached.items()}, reached
    )


def rows(
    methods: list[SeedSamples], price: float, against: SeedSamples | str
) -> list[dict[str, Any]]:
    name = against if isinstance(against, str) else against.name
    stored = Stored(tuple(methods), {"0": 5}, ())
    found = document(Comparison(stored, "pitch_variation_100hz", "rad", price, name))
    table: list[dict[str, Any]] = found["methods"]
    return table


def test_every_pair_can_be_compared_and_has_a_row_of_its_own() -> None:
    methods = [method(name, (many, 10)) for name, many in (("a", 10), ("b", 8), ("c", 2))]
    found = rows(methods, 6.28, ALL)
    pairs = [(one["method"], g["against"]) for one in found for g in one.get("comparisons", ())]
    assert pairs == [("b", "a"), ("c", "a"), ("c", "b")]
    largest = found[2]["comparisons"][0]
    assert largest["p_success_holm"] == pytest.approx(3 * largest["p_success"])
    names = {"measure": "m", "price": 6.28, "episodes": {"0": 10}, "notices": [], "methods": found}
    table, gaps = tables(names, "m [rad]")
    note = "Score: m [rad]; a failed episode counts 6.28, and a crossing at most that. Its 95 %"
    assert [text[: len(note)] for text in table.notes] == [note]
    assert [row["other"] for row in gaps.rows] == ["a", "a", "b"]


def test_scenes_weigh_the_same_in_a_difference_of_success_as_in_the_success() -> None:
    """By episodes, the second scene would decide: 20 of 110 lost, and 8 won."""
    ours, other = method("ours", (10, 10), (60, 100)), method("other", (2, 10), (80, 100))
    first, second = rows([other, ours], 6.28, other)
    assert (first["success"]["mean"], second["success"]["mean"]) == pytest.approx((0.5, 0.8))
    assert second["comparison"]["success"]["mean"] == pytest.approx(0.3)
    assert second["comparison"]["p_success"] < 0.05


def test_one_scene_is_compared_pair_by_pair() -> None:
    ours, other = method("ours", (10, 10)), method("other", (2, 10))
    _, row = rows([other, ours], 6.28, other)
    assert row["comparison"]["success"]["mean"] == pytest.approx(0.8)
    assert row["comparison"]["p_success"] == pytest.approx(2 * 0.5**8)  # McNemar's exact test


def test_few_outcomes_that_leave_no_variation_prove_no_more_than_their_number() -> None:
    """One scene is mixed alike for both, and the other one all against none."""
    ours, other = method("ours", (3, 5), (5, 5)), method("other", (3, 5), (0, 5))
    found = rows([other, ours], 6.28, other)[1]["comparison"]
    success = found["success"]
    assert success["mean"] == pytest.approx(0.5)
    assert success["low"] < 0.35 < 0.6 < success["high"]
    assert found["p_success"] == pytest.approx(2 * 0.5**5)
    assert (found["better"]["low"], found["better"]["high"]) == (None, None)


def test_equal_scores_do_not_tell_how_others_would_vary() -> None:
    """All fail, so that each costs the price; and all reach with equal scores.

    Sums of equal numbers differ by rounding: 1.2 does, 1.0 does not.
    """
    failed, reached = method("failed", (0, 6)), method("reached", (6, 6))
    found = rows([failed, reached], 6.28, failed)
    none = {"low": None, "high": None}
    assert found[0]["score"] == {"mean": 6.28, **none}
    assert found[0]["by_scene"] == {"0": {"mean": 6.28, **none}}
    three = {"0": np.zeros((3, 20), bool)}
    many = replace(failed, values={"0": np.ones((3, 20))}, reached=three)
    for price in (0.7, 1.2, 1.6, 3.2):
        (row,) = rows([many], price, many)
        assert [row[k][end] for k in ("score", "iqm") for end in none] == [None] * 4
    compared = found[1]["comparison"]
    assert compared["score"] == {"mean": 1.0 - 6.28, **none}
    assert compared["p"] == 1.0
    assert compared["p_success"] < 0.05


def test_the_interval_of_a_score_ends_where_scores_do() -> None:
    """Nothing costs less than 0, or more than the price and the largest score."""
    row = rows([found := method("m", (1, 6))], 6.28, found)[0]
    assert row["score"]["high"] == 6.28
    low = replace(found, values={"0": np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 2.0]])})
    low = replace(low, reached={"0": np.ones((1, 6), bool)})
    assert rows([low], 6.28, low)[0]["score"]["low"] == 0.0


def test_a_difference_of_success_ends_at_1() -> None:
    rng = np.random.default_rng(0)
    ours = np.ones((2, 6), bool)
    theirs = np.stack([rng.random(6) < 0.4, np.zeros(6, bool)])
    methods = [
        SeedSamples(n, {"a": np.ones(r.shape)}, {"a": r}) for n, r in (("o", ours), ("t", theirs))
    ]
    found = rows(methods, 6.28, methods[1])[0]["comparison"]
    assert found["success"]["high"] == 1.0


@pytest.mark.parametrize(
    ("labels", "short"),
    [
        (("runs/cmp/network=at_d3qn", "runs/cmp/network=mlp", "level"),
         ("at_d3qn", "mlp", "level")),
        (("s/network=mlp,agent.gamma=0.9", "s/network=mlp,agent.gamma=1"),
         ("mlp, gamma=0.9", "mlp, gamma=1")),
        (("s/0_network=mlp,seed=1", "s/1_network=conv,seed=1"), ("mlp", "conv")),
        (("s/0_network=mlp,seed=1", "s/1_network=mlp,seed=2"), ("mlp, seed=1", "mlp, seed=2")),
        (("s/0_seed=1", "level"), ("s", "level")),
        (("s/0_seed=1", "s/1_seed=2"), ("seed=1", "seed=2")),
        (("runs/first/checkpoints/best.safetensors", "b.onnx"), ("first", "b.onnx")),
        (("a/run", "b/run"), ("a/run", "b/run")),
        (("runs/1/best", "runs/1/last"), ("best", "last")),
    ],
)  # fmt: skip
def test_the_last_parts_that_differ(labels: tuple[str, ...], short: tuple[str, ...]) -> None:
    assert tuple(names(labels).values()) == short
