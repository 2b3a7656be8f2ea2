"""Random messages lead to an estimate with its certainty or to a reason."""

import pytest

from benchmarks import estimator_fuzz
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.sensing import Measured


def test_each_random_message_leads_to_an_estimate_or_a_reason() -> None:
    results = estimator_fuzz.fuzz(300, 100)
    assert sum(results.values()) == 300
    assert results["estimate"] >= 30
    assert sum(count for text, count in results.items() if text.startswith("reason")) >= 30


def test_another_exception_is_reported_with_its_seed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def update(self: LidarEstimator, measured: Measured) -> None:
        raise IndexError("out of range")

    monkeypatch.setattr(LidarEstimator, "update", update)
    assert estimator_fuzz.main(["--count", "1", "--seed", "7"]) == 1
    assert "--seed 7: IndexError: out of range" in capsys.readouterr().out
