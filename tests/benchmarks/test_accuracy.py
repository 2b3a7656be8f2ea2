"""Substeps against finer ones."""

from dataclasses import replace

import pytest

from benchmarks import policy_accuracy
from tests.benchmarks.small import small_benchmark


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
