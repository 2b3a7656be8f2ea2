"""Substeps against finer ones."""

from dataclasses import replace

import pytest

from benchmarks import accuracy, policy_accuracy
from tests.bench.small import check, check_ratio
from tests.benchmarks.small import small_benchmark


def test_each_substep_is_compared_with_the_finest() -> None:
    found = accuracy.measure(small_benchmark(starts=2))
    check(found)
    assert len(found["quantities"]) == 2 * 2 * 4 + 4
    for policy in ("okada", "generalist_first"):
        change = found["quantities"][f"{policy}.change"]["values"]
        assert len(change) == 2  # both starts reach the finish, at both substeps
        assert all(0 < value < 0.5 for value in change)
        assert found["quantities"][f"{policy}.changed_outcomes"]["values"] == [0.0]
        by_terrain = found["by_terrain"][policy]
        assert by_terrain == {"step": {"changes": change, "changed_outcomes": 0.0}}
    assert found["missing"] == []
    for scene in ("paper_step", "paper_stair", "paper_step.100hz", "paper_stair.100hz"):
        coarse, finest = f"{scene}.5ms", f"{scene}.1.25ms"
        check_ratio(found, f"{coarse} / {finest}", coarse, finest)
        # Another substep gives another trajectory with nearly the same θ̂_R.
        values = [found["quantities"][name]["values"] for name in (coarse, finest)]
        assert values[0] != values[1]
        assert 0.9 < found["ratios"][f"{coarse} / {finest}"]["ratio"] < 1.1


def test_changes_by_hand() -> None:
    pairs = [
        ({"outcome": a, "pitch_variation_100hz": x}, {"outcome": b, "pitch_variation_100hz": y})
        for a, x, b, y in (
            ("reached", 1.1, "reached", 1.0),
            ("reached", 1.8, "reached", 2.0),
            ("stuck", 3.0, "reached", 1.0),
            ("stuck", 3.0, "stuck", 1.0),
        )
    ]
    assert policy_accuracy.changes(pairs) == pytest.approx([0.1, 0.1])
    assert policy_accuracy.changed_outcomes(pairs) == 0.25


def test_a_policy_for_another_observation_is_left_out() -> None:
    bench = small_benchmark()
    config = bench.config.model_validate(
        {**bench.config.model_dump(), "perception": {"name": "planar", "bins": 9}}
    )
    found = policy_accuracy.measure_policies(replace(bench, config=config), 0.0)
    assert list(found["quantities"]) == ["okada.change", "okada.changed_outcomes"]
    assert "15 bins" in found["missing"][0]
