"""Every measure of ``python -m benchmarks`` at its smallest; formulas have tests of their own."""

from importlib import import_module
from typing import Any

import pytest
import torch

from benchmarks import lidar
from benchmarks.settings import MEASURES
from tests.bench.small import check
from tests.benchmarks.small import small_benchmark

RATIOS = {
    "physics": "environment_decisions / bare_decisions",
    "accuracy": "paper_step.100hz.5ms / paper_step.100hz.1.25ms",
    "lookahead": "simulated_decisions / environment_decisions",
    "lidar": "lidar.true / true_ground",
    "updates": "flipperctl / sb3_fused, updates of 32",
    "solve": "sb3 / flipperctl, decisions",
    "startup": "flipperctl --help / python -c pass",
}
"""One of the ratios of each measure, which the documentation explains."""


def measured(name: str, **changes: object) -> dict[str, Any]:
    return dict(import_module(f"benchmarks.{name}").measure(small_benchmark(**changes)))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.long] * (name != "physics")) for name in MEASURES],
)
def test_a_measure_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"name": "lidar", "azimuths": 8, "scan_parts": 1}
    monkeypatch.setattr(lidar, "CONTESTANTS", {lidar.TRUE: {"name": "planar"}, "lidar.true": few})
    threads = torch.get_num_threads()
    found = measured(name)
    check(found)
    assert found.get("missing", []) == []
    assert torch.get_num_threads() == threads
    if name in RATIOS:
        assert found["ratios"][RATIOS[name]]
