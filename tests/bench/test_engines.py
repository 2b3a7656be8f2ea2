"""Simulated time for each second of CPU time, by engine."""

import sys
from dataclasses import replace

import pytest

from flipperctl.bench import engines
from flipperctl.bench.settings import ENGINE_GROUNDS
from flipperctl.config import with_overrides
from tests.bench.small import check, check_ratio, small_bench


@pytest.fixture(autouse=True)
def our_engines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the engines of other tests."""
    monkeypatch.setattr(engines, "registered_names", lambda kind: ["mujoco", "planar"])


def test_each_engine_is_timed_on_each_ground() -> None:
    found = engines.measure(small_bench(families=2))
    check(found)
    assert list(found["quantities"]) == [
        f"{engine}.{ground}{what}"
        for engine in ("mujoco", "planar")
        for ground in ENGINE_GROUNDS[:2]
        for what in ("", ".environment")
    ]
    assert len(found["ratios"]) == 4
    for above in ("mujoco.stair", "mujoco.stair.environment"):
        below = above.replace("mujoco", "planar")
        check_ratio(found, f"{above} / {below}", above, below)
    assert found["missing"] == []


def test_the_engine_alone_and_the_environment_simulate_the_same_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seconds = iter(range(100))
    config = small_bench().config.environment()
    clock = engines.Clock(config, "okada", [5])
    # Every reading of the clock is one second after the one before.
    monkeypatch.setattr(engines.time, "process_time", lambda: float(next(seconds)))
    simulated = clock.engine()
    assert simulated > 5  # 1.5 m at 0.2 m/s, at least
    assert clock.environment() == simulated


def test_the_chosen_engine_keeps_its_settings() -> None:
    bench = small_bench()
    config = with_overrides(bench.config, {"sim": {"name": "planar", "friction": 0.9}})
    clocks, _ = engines._clocks(replace(bench, config=config))
    settings = {name: clock._env.config.sim.model_dump() for name, clock in clocks.items()}
    assert settings["planar.flat"]["friction"] == 0.9
    assert settings["mujoco.flat"]["friction"] == 1.0


def test_an_engine_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    found = engines.measure(small_bench())
    assert [name for name in found["quantities"] if name.startswith("mujoco")] == []
    assert found["ratios"] == {}
    (text,) = found["missing"]
    assert "pip install 'flipperctl[mujoco]'" in text
