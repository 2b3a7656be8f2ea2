"""Speed of episodes with a LiDAR."""

import pytest

from benchmarks import lidar
from tests.bench.small import check, check_ratio
from tests.benchmarks.small import small_benchmark


def test_episodes_on_the_true_ground_and_with_a_lidar_are_timed_in_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few = {"name": "lidar", "azimuths": 8, "scan_parts": 1}
    monkeypatch.setattr(lidar, "CONTESTANTS", {lidar.TRUE: {"name": "planar"}, "lidar.true": few})
    found = lidar.measure(small_benchmark(repeats=2))
    check(found)
    check_ratio(found, "lidar.true / true_ground", "lidar.true", "true_ground")
    assert found["missing"] == []
